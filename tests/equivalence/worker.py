"""Runs the stages of one tree, one after the other, each in a process of its own.

    PYTHONPATH=<tree> python -P worker.py jobs.json outcomes.json

Libraries are imported once: each stage is a fork of this process, which has loaded the modules of
all stages and run none. A stage that needs one that failed is not run. This imports nothing of the
repository but what stages import, so that the tree is the one that PYTHONPATH names.
"""

import json
import os
import runpy
import sys
from pathlib import Path
from typing import Any

LOADED = "loaded"  # in place of `__main__`: a script's imports and functions, without its call


def run(argv: list[str], name: str) -> None:
    """Run a script, or a module after `-m`, with its arguments."""
    if argv[0] == "-m":
        sys.argv = argv[1:]
        runpy.run_module(argv[1], run_name=name, alter_sys=True)
    else:
        sys.argv = argv
        runpy.run_path(argv[0], run_name=name)


def forked(job: dict[str, Any]) -> int:
    """The exit code of one job, whose output goes to its log."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    code: Any = 1
    try:
        log = os.open(job["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.chdir(job["folder"])
        run(job["argv"], "__main__")
        code = 0
    except SystemExit as error:
        code = error.code or 0
    except BaseException:
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 1)


def load(jobs: list[dict[str, Any]], tree: Path) -> None:
    """Import what the jobs' scripts import, and see that it comes from this tree."""
    scripts = {}
    for job in jobs:
        module = job["argv"][0] == "-m"
        words = job["argv"][:2] if module else [str(Path(job["folder"], job["argv"][0]).resolve())]
        scripts[" ".join(words)] = words
    for words in scripts.values():
        run(words, LOADED)
    import deblur_avatar

    if not Path(deblur_avatar.__file__).is_relative_to(tree):
        raise SystemExit(f"{deblur_avatar.__file__} is not in {tree}")


def main(jobs_file: Path, outcomes_file: Path) -> None:
    """Run all jobs and write their exit codes by name; null for what was not run."""
    jobs = json.loads(jobs_file.read_text())
    load(jobs, Path(os.environ["PYTHONPATH"]))
    outcomes: dict[str, int | None] = {}
    for job in jobs:
        ready = all(outcomes[name] == 0 for name in job["needs"])
        outcomes[job["name"]] = forked(job) if ready else None
    outcomes_file.write_text(json.dumps(outcomes))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
