"""A repository whose stages copy files slowly, for tests of sweeps."""

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from unittest import mock

from deblur_avatar.cli.main import main
from tests.process_state import ended_here
from tests.structure import small_repository
from tests.structure.small_repository import begin, commit

ROOT = Path(__file__).parents[2]
SWEEP = (sys.executable, "-m", "deblur_avatar.cli.main", "sweep")
STAGES = """\
stages:
  code:
    cmd: python ${from.root}/stages/code.py --root ${from.root} --out code.json
    always_changed: true
    outs:
      - code.json: {cache: false}
  warm:
    foreach: ${warmed}
    do:
      cmd: python ${from.root}/stages/grow.py params.yaml data/warm/${key} metrics/warm/${key}.json
      deps: [params.yaml]
      params:
        - code.json: [grow]
      outs:
        - data/warm/${key}
        - metrics/warm/${key}.json: {cache: false}
  fit:
    foreach: ${runs}
    do:
      cmd: >-
        python ${from.root}/stages/grow.py data/warm/${item.warm} data/fit/${key}
        metrics/fit/${key}.json
      deps: ["data/warm/${item.warm}"]
      params:
        - code.json: [grow]
        - params.yaml: ["runs.${key}"]
      outs:
        - data/fit/${key}
        - metrics/fit/${key}.json: {cache: false}
  score:
    foreach: ${runs}
    do:
      cmd: >-
        python ${from.root}/stages/grow.py data/fit/${key} data/score/${key}
        metrics/score/${key}.json
      deps: ["data/fit/${key}"]
      params:
        - code.json: [grow]
      outs:
        - data/score/${key}
        - metrics/score/${key}.json: {cache: false}
  report:
    foreach: ${reports}
    do:
      cmd: >-
        python -c "import pathlib; proof = pathlib.Path('${item}/proof'); proof.mkdir(parents=True);
        page = str(sorted(pathlib.Path('metrics').rglob('*.json')));
        [(folder / 'index.html').write_text(page) for folder in (proof, proof.parent)]"
      deps: [metrics]
      outs:
        - ${item}/index.html: {cache: false}
        - ${item}/proof: {cache: false}
"""
PARAMS = """\
from: {root: .}
warmed: {root_a: {}, root_b: {}}
runs:
  root_one: {warm: root_a}
  root_two: {warm: root_a}
  root_three: {warm: root_b}
reports: [reports]
"""
OF_MORE = """\
from: {root: ../..}
warmed: {more_a: {}}
runs:
  more_one: {warm: more_a, size: 0}
  more_two: {warm: more_a}
reports: []
"""
MORE = "experiments/more"
# A stage that says what it is doing in `begun/`, and does what a file of its name in `told/` says.
GROW = """\
import json, os, signal, sys, time
from pathlib import Path
seen, out, metrics = map(Path, sys.argv[1:])
here = Path(__file__).parents[1]
begun = here / 'begun' / out.name
begun.parent.mkdir(exist_ok=True)
with begun.open('a') as file:
    file.write(f'{out.parent.name} {os.getpid()}\\n')
told = here / 'told' / f'{out.parent.name}-{out.name}'
word = told.read_text() if told.exists() else ''
if word == 'fail':
    sys.exit('the cloth is torn')
if word == 'die once':
    told.unlink()
    os.kill(os.getpid(), signal.SIGKILL)
for _ in range(600):
    if not (told.exists() and told.read_text() == 'wait'):
        break
    time.sleep(0.1)
text = seen.read_text() if seen.is_file() else (seen / 'text').read_text()
out.mkdir(parents=True)
(out / 'text').write_text(text + out.name)
metrics.parent.mkdir(parents=True, exist_ok=True)
metrics.write_text(json.dumps({'length': len(text)}))
"""


def begin_project(root: Path) -> None:
    """The repository, with nothing run: a pipeline at its root, a copy in an experiment.

    The root has more than half of all stages: only then is the order of `dvc repro` always the
    same.
    """
    files = {
        "dvc.yaml": STAGES, "params.yaml": PARAMS,
        f"{MORE}/dvc.yaml": STAGES, f"{MORE}/params.yaml": OF_MORE,
        "stages/grow.py": GROW,
        "stages/code.py": small_repository.CODE,
        ".gitignore": "code.json\ndata/\nmetrics/\nreports/\nbegun/\ntold/\n",
    }  # fmt: skip
    begin(root, files)
    commit(root)


def copied(project: Path, to: Path) -> Path:
    """Another of the same."""
    return Path(shutil.copytree(project, to, symlinks=True))


def tell(project: Path, stage: str, word: str) -> None:
    """What a stage shall do: `fail`, `die once` or `wait`."""
    (project / "told").mkdir(exist_ok=True)
    (project / "told" / stage).write_text(word)


def begun(project: Path, item: str) -> list[str]:
    """The stages that began for an item, each time."""
    path = project / "begun" / item
    lines = path.read_text().splitlines() if path.is_file() else []
    return [line.split()[0] for line in lines]


def process_of(project: Path, item: str) -> int:
    """The process that began last for an item."""
    return int((project / "begun" / item).read_text().split()[-1])


def results(project: Path) -> dict[str, bytes]:
    """Locks and all that stages wrote, by path."""
    files = [
        *project.rglob("dvc.lock"),
        *project.rglob("data/**/*"),
        *project.rglob("metrics/**/*"),
    ]
    return {
        path.relative_to(project).as_posix(): path.read_bytes() for path in files if path.is_file()
    }


def results_of_root(project: Path) -> dict[str, bytes]:
    """Of the pipeline at its root alone."""
    return {k: v for k, v in results(project).items() if not k.startswith(MORE)}


def called(project: Path, *command: str) -> str:
    """What a command says there, by this repository's code; it must end well."""
    return small_repository.called(project, *command, code=ROOT)


def swept(project: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """A sweep by this repository's code, which may end badly."""
    return subprocess.run(
        [*SWEEP, *words], cwd=project, env=variables(), capture_output=True, text=True, check=False
    )


def swept_here(project: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """The same in this process, which has imported DVC already."""
    with contextlib.chdir(project), mock.patch.dict(os.environ, variables()):
        return ended_here(SWEEP[1:], lambda: main(["sweep", *words]))


def variables() -> dict[str, str]:
    """Of a command that runs this repository's code."""
    return os.environ | {"PYTHONPATH": str(ROOT), "DVC_NO_ANALYTICS": "1"}
