"""A repository whose stages copy files slowly, for tests of sweeps."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

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
        python -c "import pathlib; folder = pathlib.Path('${item}'); folder.mkdir();
        (folder / 'index.html').write_text(str(sorted(pathlib.Path('metrics').rglob('*.json'))))"
      deps: [metrics]
      outs:
        - ${item}: {cache: false}
"""
PARAMS = """\
from: {root: ROOT}
warmed: {NAME_a: {}, NAME_b: {}}
runs:
  NAME_one: {warm: NAME_a, size: 0}
  NAME_two: {warm: NAME_a}
  NAME_three: {warm: NAME_b}
reports: [REPORTS]
"""
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
# The root has more than half of all stages: only then is the order of `dvc repro` always the same.
FOLDERS = ("", "experiments/more")


def begin_project(root: Path) -> None:
    """The repository, with nothing run: a pipeline at its root, a copy in an experiment."""
    files = {
        "stages/grow.py": GROW,
        "stages/code.py": (ROOT / "stages/code.py").read_text(),
        ".gitignore": "code.json\ndata/\nmetrics/\nreports/\nbegun/\ntold/\n",
    }
    for folder in FOLDERS:
        up = "../.." if folder else "."
        name = Path(folder).name or "root"
        files[str(Path(folder, "dvc.yaml"))] = STAGES
        params = PARAMS.replace("ROOT", up).replace("NAME", name)
        files[str(Path(folder, "params.yaml"))] = params.replace(
            "REPORTS", "" if folder else "reports"
        )
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


def called(project: Path, *command: str) -> str:
    """What a command says there, by this repository's code; it must end well."""
    return small_repository.called(project, *command, code=ROOT)


def swept(project: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """A sweep by this repository's code, which may end badly."""
    return subprocess.run(
        [*SWEEP, *words], cwd=project, env=variables(), capture_output=True, text=True, check=False
    )


def variables() -> dict[str, str]:
    """Of a command that runs this repository's code."""
    return os.environ | {"PYTHONPATH": str(ROOT), "DVC_NO_ANALYTICS": "1"}
