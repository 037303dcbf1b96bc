"""Stage `code`: a fingerprint of the code of every stage, on which the others depend."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.code import fingerprints


def main(root: Path, out: Path) -> None:
    """Write `out`: for each script of `<root>/stages`, and each kind that the parameters beside
    `out` ask for, a hash over the code that it runs.
    """
    write_json(out, fingerprints(root, out.parent))


if __name__ == "__main__":
    run.command(main)
