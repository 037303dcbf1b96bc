"""The command `deblur-avatar`: one subcommand a module of this folder."""

import argparse
import importlib
import logging
import sys
from collections.abc import Collection, Sequence

import deblur_avatar
from deblur_avatar.ending import exit_code, leave_at_once, raise_again

# Modules and what they do; a module is imported once it is asked for, because torch takes seconds.
COMMANDS = {
    "setup": "install what pip cannot; once an environment",
    "video": "from a video of one person to an avatar, a check and a report",
    "check": "say whether scenes are fit for training",
    "repro": "run the whole pipeline as far as this machine has the footage",
    "proof": "fit every avatar with every motion on the report scenes, and say what it is worth",
    "sweep": "run pipelines' stages many at a time, on this machine or a Ray cluster",
    "report": "write the report over the results there are",
    "film": "write the video of a street scene",
    "export": "write a fitted run as a file that other programs open",
    "view": "turn a fitted avatar by hand in a browser on this machine",
    "completion": "print what completes these words on a shell's command line",
}
MANUAL = """\
first steps, in any folder:
  deblur-avatar setup
  deblur-avatar video clip.mp4            writes ./clip/avatar.html
  deblur-avatar <command> --help          what a command reads and writes

setup, video, export, view and completion run anywhere; check, repro, proof, sweep, report and film
run the repository's own pipelines, in a checkout of it.

exit codes:
  0    all went well; of video also where the avatar fails its self-check, which its last line says
  1    bad input: one line says what was wanted, what came, where, and what to do;
       of sweep and proof also a task that failed
  2    bad usage
  130  stopped by Ctrl-C; the same command goes on where it stopped
  other codes are DVC's: a stage failed, and what it said stands above

environment:
  DEBLUR_AVATAR_DEVICE          cpu, cuda; default: a GPU where there is one and gsplat
  DEBLUR_AVATAR_THREADS         of native kernels; results are the same for any number
  DEBLUR_AVATAR_CACHE           where compiled kernels and baked bodies are kept, for all folders;
                                default: $XDG_CACHE_HOME or ~/.cache, there deblur_avatar
  DEBLUR_AVATAR_LPIPS_WEIGHTS   VGG16's weights, for the perceptual distance; none are shipped
"""


class _Version(argparse.Action):
    """Looked up only when it is asked for: a checkout that is not installed has none."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        sys.stdout.write(f"{parser.prog} {deblur_avatar.__version__}\n")
        parser.exit()


def main(words: Sequence[str] | None = None) -> int:
    """Run one subcommand; returns the exit code.

    Args:
        words: of the command line; the process's own if None.
    """
    words = sys.argv[1:] if words is None else list(words)
    leave_at_once()  # not KeyboardInterrupt while torch is loaded, which takes seconds
    try:
        asked = command_parser(words[:1]).parse_args(words)
    finally:
        raise_again()
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    return exit_code(lambda: asked.execute(asked))


def command_parser(loaded: Collection[str]) -> argparse.ArgumentParser:
    """The parser of all subcommands; only those named in `loaded` know their own arguments."""
    parser = argparse.ArgumentParser(
        prog="deblur-avatar",
        description="Sharp, animatable Gaussian avatars from motion-blurred video.",
        epilog=MANUAL,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="say it and exit")
    commands = parser.add_subparsers(dest="command", metavar="command", required=True)
    for name, purpose in COMMANDS.items():
        module = importlib.import_module(f"{__package__}.{name}") if name in loaded else None
        command = commands.add_parser(
            name, help=purpose, description=module.__doc__ if module else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        if module:
            module.add_arguments(command)
            command.set_defaults(execute=module.run)
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
