"""The command `deblur-avatar`: one subcommand a module of this folder.

Ends with 0 if all went well, 1 with one line for bad input, 2 for bad usage, and with DVC's own
code where DVC failed.
"""

import argparse
import importlib
import logging
import sys
from collections.abc import Sequence

from deblur_avatar.errors import ArtifactError, ConfigError, FittingError

# Modules and what they do; a module is imported once it is asked for, because torch takes seconds.
COMMANDS = {
    "video": "from a video of one person to an avatar, a check and a report",
    "check": "say whether scenes are fit for training",
    "repro": "run the whole pipeline as far as this machine has the footage",
    "proof": "fit every avatar with every motion on the report scenes, and say what it is worth",
    "report": "write the report over the results there are",
    "film": "write the video of a street scene",
    "export": "write a fitted run as a file that other programs open",
    "view": "turn a fitted avatar by hand in a browser on this machine",
}


def main(words: Sequence[str] | None = None) -> int:
    """Run one subcommand; returns the exit code.

    Args:
        words: of the command line; the process's own if None.
    """
    words = sys.argv[1:] if words is None else list(words)
    parser = argparse.ArgumentParser(
        prog="deblur-avatar",
        description="Sharp, animatable Gaussian avatars from motion-blurred video.",
        epilog="All but export and view run the repository's pipeline, in a checkout of it.",
    )
    commands = parser.add_subparsers(dest="command", metavar="command", required=True)
    for name, purpose in COMMANDS.items():
        module = importlib.import_module(f"{__package__}.{name}") if words[:1] == [name] else None
        command = commands.add_parser(
            name, help=purpose, description=module.__doc__ if module else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        if module:
            module.add_arguments(command)
            command.set_defaults(execute=module.run)
    asked = parser.parse_args(words)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    try:
        code: int = asked.execute(asked)
    except (ConfigError, ArtifactError, FittingError) as error:
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        return 1
    return code


if __name__ == "__main__":
    raise SystemExit(main())
