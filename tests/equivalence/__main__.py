"""Relocking: after a pure refactoring, locks that say so; nothing is run again.

    python -m tests.equivalence --base <commit> [--renamed old=new,...] [--changed stage,...]

Runs the small cases of a commit and of the present tree, compares every byte, and writes the locks
of all pipelines only if none differs (docs/decisions/0025-relocking.md).
"""

import argparse
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path, PurePosixPath

from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.code import refresh
from deblur_avatar.sweep.costs import stage_of
from tests.equivalence.cases import footage_variables
from tests.equivalence.coverage import NOT_IN_SMALL, kinds
from tests.equivalence.footage import write_footage
from tests.equivalence.locks import Relocked, Relocking
from tests.equivalence.names import Renaming
from tests.equivalence.proof import Proven, Question, Trees, git, prove, trees
from tests.equivalence.recorded import Recorded, entries


def say(line: str) -> None:
    """One line for the user."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def relock(root: Path, there: Trees, renaming: Renaming, proven: Proven) -> Relocked:
    """Write the locks of the present tree."""
    refresh(root)
    files = git(root, "ls-files", "-z").split("\0")
    tracked = {
        str(path) for file in files for path in (PurePosixPath(file), *PurePosixPath(file).parents)
    }
    base = Recorded(there.then, renaming)
    return Relocking(root, base, proven, tracked).relock(entries(root))


def table(done: Relocked) -> list[str]:
    """What was done: per pipeline and stage, how many are locked and why others are not."""
    lines = []
    locked = [*done.kept, *done.vouched]
    for folder in sorted({name.partition(":")[0] for name in [*locked, *done.left_out]}):
        here = Counter(stage_of(name) for name in locked if name.partition(":")[0] == folder)
        lines.append(f"{folder}: {sum(here.values())} locked")
        lines += [f"  {count:4d} {stage}" for stage, count in sorted(here.items())]
        lines += [
            f"  left out: {name.partition(':')[2]}: {reason}"
            for name, reason in done.left_out.items()
            if name.partition(":")[0] == folder
        ]
    alone = Counter(
        re.sub(r"^(\w+)\.[^.:]+\.", r"\1.*.", key) for keys in done.vouched.values() for key in keys
    )
    if alone:
        lines.append("in one version alone, of what is locked:")
        lines += [f"  {count:4d} {key}" for key, count in sorted(alone.items())]
    return lines


def main() -> int:
    """Prove, then write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--base", required=True, help="the commit to compare with")
    parser.add_argument("--renamed", default="", help="old=new,... of whole words")
    parser.add_argument("--changed", default="", help="stages that do something else: not relocked")
    arguments = parser.parse_args()
    root = Path.cwd()
    try:
        renaming = Renaming.parsed(arguments.renamed)
        with trees(root, arguments.base) as there:
            footage = there.scratch / "footage"
            variables = footage_variables(footage, root)
            write_footage(footage)
            asked = Question(
                renaming,
                tuple(filter(None, arguments.changed.split(","))),
                frozenset(kinds() - NOT_IN_SMALL),
                variables,
            )
            proven = prove(there, asked, say)
            for line in table(relock(root, there, renaming, proven)):
                say(line)
    except (ConfigError, subprocess.CalledProcessError) as error:
        sys.stderr.write(f"no lock is written:\n{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
