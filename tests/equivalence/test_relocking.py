"""Locks after a refactoring, on a project of two small stages with cases of its own."""

import shutil
from pathlib import Path

import pytest

from deblur_avatar.pipeline.code import import_closure
from tests.equivalence.__main__ import relock, table
from tests.equivalence.names import Renaming
from tests.equivalence.proof import Question, RefusedError, prove, trees
from tests.structure.small_repository import begin, called, commit, ran

ROOT = Path(__file__).parents[2]
CODE = "deblur_avatar/pipeline/code.py"
# And what it imports.
OF_CODE = sorted(path.relative_to(ROOT).as_posix() for path in import_closure(ROOT / CODE, ROOT))
PIPELINE = """\
stages:
  code:
    cmd: python ${from.root}/stages/code.py ${from.root}
    always_changed: true
    outs:
      - code.json: {cache: false}
  cut:
    foreach: ${runs}
    do:
      cmd: python ${from.root}/stages/cut.py ${key} ${item.size} data/${key}
      deps: ["${from.root}/pattern.txt"]
      params:
        - code.json: [cut]
        - params.yaml: [seed, "runs.${key}"]
      outs: ["data/${key}"]
  weigh:
    foreach: ${runs}
    do:
      cmd: python ${from.root}/stages/weigh.py data/${key} metrics/${key}.json
      deps: ["data/${key}"]
      params:
        - code.json: [weigh]
      outs:
        - metrics/${key}.json: {cache: false}
"""
FILES = {
    "dvc.yaml": PIPELINE,
    "experiments/cases/dvc.yaml": PIPELINE,
    "params.yaml": "from: {root: .}\nseed: 0\nruns: {long: {size: 9}, short: {size: 1}}\n",
    "experiments/cases/params.yaml": "from: {root: ../..}\nseed: 0\nruns: {small: {size: 2}}\n",
    "pattern.txt": "two sleeves",
    ".gitignore": "code.json\ndata/\n/experiments/cases/metrics/\n",
    "deblur_avatar/__init__.py": "",
    "deblur_avatar/pipeline/__init__.py": "",
    "deblur_avatar/cutting.py": "def cut(size):\n    return 'x' * int(size)\n",
    "stages/code.py": (
        "import json, sys\nfrom pathlib import Path\n"
        "from deblur_avatar.pipeline.code import fingerprints\n"
        "hashes = json.dumps(fingerprints(Path(sys.argv[1]), Path()), indent=1)\n"
        "Path('code.json').write_text(f'{hashes}\\n')\n"
    ),
    "stages/cut.py": (
        "import sys\nfrom pathlib import Path\nfrom deblur_avatar.cutting import cut\n"
        "if __name__ == '__main__':\n    folder = Path(sys.argv[3])\n"
        "    folder.mkdir(parents=True)\n    (folder / 'cloth.txt').write_text(cut(sys.argv[2]))\n"
    ),
    "stages/weigh.py": (
        "import json, sys\nfrom pathlib import Path\n"
        "if __name__ == '__main__':\n    out = Path(sys.argv[2])\n"
        "    out.parent.mkdir(exist_ok=True, parents=True)\n"
        "    weight = len(Path(sys.argv[1], 'cloth.txt').read_text())\n"
        "    out.write_text(json.dumps({'weight': weight, 'name': out.stem}))\n"
    ),
}
ALL = {"cut@long", "cut@short", "weigh@long", "weigh@short"}


def would_run(folder):
    """Stages that DVC says are out of date, by fingerprints of the present code."""
    called(folder, "python", "stages/code.py", ".")
    return ran(folder, "--dry", "--allow-missing")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    root = tmp_path_factory.mktemp("made")
    begin(root, FILES | {name: (ROOT / name).read_text() for name in OF_CODE})
    called(root, "dvc", "repro")
    commit(root)
    return root


@pytest.fixture
def project(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "copy", symlinks=True))


def replaced(project, file, old, new):
    path = project / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def relocked(project, renamed="", changed=(), base="HEAD"):
    """What becomes of each stage, and the proof's lines on standard output."""
    renaming = Renaming.parsed(renamed)
    with trees(project, base) as there:
        proven = prove(there, Question(renaming, changed, frozenset(), {}), lambda _: None)
        return relock(project, there, renaming, proven)


def moved(project):
    """A pure refactoring: a module and its function by other names."""
    (project / "deblur_avatar/cutting.py").rename(project / "deblur_avatar/scissors.py")
    replaced(project, "deblur_avatar/scissors.py", "def cut", "def snip")
    replaced(project, "stages/cut.py", "cutting import cut", "scissors import snip")
    replaced(project, "stages/cut.py", "(cut(", "(snip(")


def test_a_pure_refactoring_reruns_nothing_once_it_is_relocked(project):
    moved(project)
    assert would_run(project) >= {"cut@long", "cut@short"}
    done = relocked(project)
    assert set(done.vouched) | set(done.kept) == {f".:{name}" for name in ALL}
    assert would_run(project) == set()
    assert table(done) == [".: 4 locked", "     2 cut", "     2 weigh"]


def test_nothing_is_left_behind(project):
    moved(project)
    relocked(project)
    assert len(called(project, "git", "worktree", "list").splitlines()) == 1
    assert not (project / "experiments/cases/data").exists()


def test_a_changed_byte_is_refused_and_no_lock_is_written(project):
    lock = (project / "dvc.lock").read_bytes()
    replaced(project, "deblur_avatar/cutting.py", "'x'", "'y'")
    with pytest.raises(
        RefusedError, match=r"^cut: experiments/cases/data/small/cloth.txt differs$"
    ):
        relocked(project)
    assert (project / "dvc.lock").read_bytes() == lock


def test_a_changed_measurement_is_refused(project):
    replaced(project, "stages/weigh.py", "weight =", "weight = 1 +")
    with pytest.raises(RefusedError, match=r"weigh: .*small.json: weight was 2, is 3"):
        relocked(project)


def test_a_case_that_fails_is_refused_with_what_it_said(project):
    replaced(project, "stages/cut.py", "folder.mkdir", "folder.mkdirs")
    with pytest.raises(RefusedError, match="cut@small failed: AttributeError.*mkdirs"):
        relocked(project)


def test_a_kind_without_a_case_is_refused(project):
    asked = Question(Renaming({}), (), frozenset({("size", "2"), ("light", "red")}), {})
    with (
        trees(project, "HEAD") as there,
        pytest.raises(RefusedError, match="^no small case has light: red$"),
    ):
        prove(there, asked, lambda _: None)


def test_what_is_said_to_have_changed_is_left_out_alone(project):
    replaced(project, "stages/weigh.py", "weight =", "weight = 1 +")
    done = relocked(project, changed=("weigh@*",))
    assert set(done.left_out) == {".:weigh@long", ".:weigh@short"}
    assert would_run(project) == {"weigh@long", "weigh@short"}


def test_an_item_that_is_said_to_have_changed_is_left_out_though_its_case_is_the_same(project):
    moved(project)
    done = relocked(project, changed=("cut@long",))
    assert done.left_out == {".:cut@long": "it is said to do something else"}


def test_a_stale_entry_is_not_declared_fresh(project):
    replaced(project, "params.yaml", "size: 9", "size: 8")
    commit(project)
    moved(project)
    done = relocked(project)
    assert set(done.left_out) == {".:cut@long"}
    assert "had changed" in done.left_out[".:cut@long"]
    assert "cut@long" in would_run(project)
    assert "cut@short" not in would_run(project)


def test_a_file_that_was_changed_and_not_run_is_not_declared_fresh(project):
    (project / "pattern.txt").write_text("three sleeves")
    commit(project)
    moved(project)
    done = relocked(project)
    assert set(done.left_out) == {".:cut@long", ".:cut@short"}
    assert "from another pattern.txt" in done.left_out[".:cut@long"]


def test_code_that_was_changed_and_not_run_is_not_declared_fresh(project):
    replaced(project, "deblur_avatar/cutting.py", "'x'", "'y'")
    commit(project)
    moved(project)
    done = relocked(project)
    assert set(done.left_out) == {".:cut@long", ".:cut@short"}


def test_a_parameter_that_says_something_else_is_not_declared_fresh(project):
    moved(project)
    replaced(project, "params.yaml", "size: 9", "size: 8")
    done = relocked(project)
    assert done.left_out == {".:cut@long": "runs.long.size was 9, is 8"}


def test_measurements_that_were_changed_by_hand_are_not_declared_fresh(project):
    moved(project)
    replaced(project, "stages/weigh.py", "weight =", "grams = weight =")
    replaced(project, "metrics/long.json", "9", "10")
    done = relocked(project)
    assert list(done.left_out) == [".:weigh@long"]
    assert "weight was 9, is 10" in done.left_out[".:weigh@long"]


def test_a_renamed_run_keeps_what_it_made(project):
    replaced(project, "params.yaml", "long", "tall")
    replaced(project, "metrics/long.json", "long", "tall")
    called(project, "git", "mv", "metrics/long.json", "metrics/tall.json")
    assert relocked(project).left_out.keys() == {".:cut@tall", ".:weigh@tall"}
    called(project, "git", "checkout", "-q", "HEAD", "dvc.lock")
    assert relocked(project, renamed="long=tall").left_out == {}
    assert would_run(project) == set()


def test_a_renamed_folder_keeps_what_lies_in_it(project):
    for folder in (".", "experiments/cases"):
        replaced(project, f"{folder}/dvc.yaml", "data/", "cloth/")
    replaced(project, ".gitignore", "data/", "cloth/")
    assert relocked(project, renamed="data=cloth").left_out == {}
    assert would_run(project) == set()
    lock = (project / "dvc.lock").read_text()
    assert lock.count(" hash: md5\n") == lock.count(" md5: ")  # without it, DVC takes another kind
