"""A mistake in every argument of every subcommand: what is said, and the exit code.

1 is what cannot be done as asked, 2 bad usage. The table in docs/commands.md is this one.
"""

import logging
import re
import shlex
import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from deblur_avatar.cli import running_dvc
from deblur_avatar.cli.completion import options_of
from deblur_avatar.cli.main import COMMANDS, main
from tests.process_state import ordinary_user
from tests.sources.small_videos import picture, write_video

ROOT = Path(__file__).parents[2]
MANUAL = ROOT / "docs/commands.md"


@dataclass(frozen=True)
class Mistake:
    """What is typed, where, and what comes of it."""

    # anywhere; a checkout; fitted: a folder with a fitted run; broken: its params.yaml is no YAML
    where: str
    typed: str
    code: int
    said: str  # a part of the only line, or of usage's last one


MISTAKES = [
    Mistake("anywhere", "", 2, "the following arguments are required: command"),
    Mistake("anywhere", "vidoe clip.mp4", 2, "invalid choice: 'vidoe' (choose from"),
    Mistake("anywhere", "setup now", 2, "unrecognized arguments: now"),
    Mistake("anywhere", "setup --dry-run=yes", 2, "--dry-run: ignored explicit argument 'yes'"),
    Mistake("anywhere", "setup --pose-model", 2, "--pose-model: expected one argument"),
    Mistake("anywhere", "setup --pose-model no.tflite", 1, "--pose-model: no file no.tflite"),
    Mistake("anywhere", "setup --pose-model texts", 1, "--pose-model: no file texts"),
    Mistake("anywhere", "video", 2, "the following arguments are required: video"),
    Mistake("anywhere", "video no.mp4", 1, "no video and no folder no.mp4"),
    Mistake("anywhere", "video notes.txt", 1, "notes.txt cannot be decoded"),
    Mistake("anywhere", "video empty.mp4", 1, "empty.mp4 cannot be decoded"),
    Mistake("anywhere", "video texts", 1, "texts is there and holds no avatar, which would be"),
    Mistake("anywhere", "video texts --name anna", 1, "holds 0 pictures, at least two are needed"),
    Mistake("anywhere", "video closed --name anna", 1, "closed may not be read by you; allow it"),
    Mistake("anywhere", "video closed/a.mp4", 1, "a.mp4 may not be read by you; allow it (chmod)"),
    Mistake("anywhere", "video mine.mp4", 1, "mine.mp4 may not be read by you; allow it (chmod)"),
    Mistake("anywhere", "video clip.mp4 two.mp4", 2, "unrecognized arguments: two.mp4"),
    Mistake("anywhere", "video clip.mp4 --name 'Anna B'", 1, "a name is small letters, digits"),
    Mistake("anywhere", "video clip.mp4 --name ../anna", 1, "a name is small letters, digits"),
    Mistake("anywhere", "video clip.mp4 --name texts", 1, "another name: --name texts_avatar"),
    Mistake("anywhere", "video clip.mp4 --name closed", 1, "closed may not be read by you"),
    Mistake("anywhere", "video clip.mp4 --name", 2, "argument --name: expected one argument"),
    Mistake("anywhere", "video clip.mp4 --method leen", 1, "no method 'leen', there is"),
    Mistake("anywhere", "video clip.mp4 --method oracle", 1, "oracle is fitted to sharp"),
    Mistake("anywhere", "video clip.mp4 --schedule larg", 1, "no schedule 'larg', there is"),
    Mistake("anywhere", "video clip.mp4 --preview=yes", 2, "--preview: ignored explicit argument"),
    Mistake("anywhere", "video clip.mp4 --own-body=yes", 2, "--own-body: ignored explicit"),
    Mistake("anywhere", "check", 1, "no dvc.yaml, params.yaml, stages in"),
    Mistake("a checkout", "check stduio", 1, "no scene 'stduio' in params.yaml, there is studio"),
    Mistake("anywhere", "repro", 1, "no dvc.yaml, params.yaml, stages in"),
    Mistake("a checkout", "repro --scenes stduio", 1, "no scene 'stduio', there is studio"),
    Mistake("a checkout", "repro --scenes", 2, "--scenes: expected at least one argument"),
    Mistake("a checkout", "repro studio", 2, "unrecognized arguments: studio"),
    Mistake("anywhere", "proof", 1, "no dvc.yaml, params.yaml, stages in"),
    Mistake("a checkout", "proof --parts gird", 1, "no part 'gird' in the proof, there is grid"),
    Mistake("a checkout", "proof --parts", 2, "--parts: expected at least one argument"),
    Mistake("a checkout", "proof --at-once 0", 1, "--at-once 0: wanted 1 or more"),
    Mistake("a checkout", "proof --at-once -1 --plan", 1, "--at-once -1: wanted 1 or more"),
    Mistake("a checkout", "proof --at-once two", 2, "--at-once: invalid int value: 'two'"),
    Mistake("a checkout", "proof --plan=yes", 2, "--plan: ignored explicit argument 'yes'"),
    Mistake("anywhere", "sweep dvc.yaml", 1, "no dvc.yaml, params.yaml, stages in"),
    Mistake("a checkout", "sweep", 2, "the following arguments are required: what"),
    Mistake("a checkout", "sweep stages", 1, "no dvc.yaml in stages or below it"),
    Mistake("a checkout", "sweep /usr", 1, "start the sweep in its own repository"),
    Mistake("a checkout", "sweep dvc.yaml --engine slurm", 2, "invalid choice: 'slurm'"),
    Mistake("a checkout", "sweep dvc.yaml --address auto", 1, "say --engine ray, too"),
    Mistake("a checkout", "sweep dvc.yaml --at-once 0", 1, "--at-once: wanted 1 or more, got 0"),
    Mistake("a checkout", "sweep dvc.yaml --retries -1", 1, "--retries: wanted 0 or more, got -1"),
    Mistake("a checkout", "sweep dvc.yaml --plan 0", 1, "--plan: wanted numbers of workers from 1"),
    Mistake("a checkout", "sweep dvc.yaml --set knots", 1, "wanted key=value or key=value,value"),
    Mistake("anywhere", "report", 1, "no dvc.yaml, params.yaml, stages in"),
    Mistake("a checkout", "report studio", 2, "unrecognized arguments: studio"),
    Mistake("anywhere", "film street --out a.mp4", 1, "no dvc.yaml, params.yaml, stages in"),
    Mistake("a checkout", "film stret --out a.mp4", 1, "scenes has no key 'stret', it has studio"),
    Mistake("a checkout", "film studio --out a.mp4", 1, "scenes.studio writes no video"),
    Mistake("a checkout", "film street --out a.avi", 1, "a video's name ends in .mp4"),
    Mistake("a checkout", "film street", 2, "the following arguments are required: --out"),
    Mistake("anywhere", "export lean --format ply --out a.ply", 1, "should name the run 'lean'"),
    Mistake("broken", "export . --format ply --out a.ply", 1, "params.yaml is not YAML: while"),
    Mistake("broken", "view .", 1, "found '<stream end>' in \"<byte string>\", line 1, column 8"),
    Mistake("fitted", "export capsules --format ply --out a.ply", 1, "no run 'capsules' in"),
    Mistake("fitted", "export . --format ply --out a.ply", 1, "has the runs capsules-lean, unmade"),
    Mistake("fitted", "export unmade --format ply --out a.ply", 1, "no avatar/1 in data/fusion"),
    Mistake("fitted", "export capsules-lean --format obj --out a.obj", 2, "invalid choice: 'obj'"),
    Mistake("fitted", "export capsules-lean --format ply --out a.obj", 1, "ends in .ply"),
    Mistake("fitted", "export capsules-lean --format ply --out notes.txt/a.ply", 1, "cannot write"),
    Mistake(
        "fitted", "export capsules-lean --format ply --out a.ply --frame 99", 1,
        "frame 99 of 8; frames are counted from 0 to 7",
    ),
    Mistake(
        "fitted", "export capsules-lean --format bvh --out a.bvh --motion fly.bvh", 1,
        "no motion file fly.bvh",
    ),
    Mistake(
        "fitted", "export capsules-lean --format bvh --out a.bvh --motion notes.txt", 1,
        "a motion is a .bvh, .npz or .pkl file, got '.txt'",
    ),
    Mistake(
        "fitted", "export capsules-lean --format page --out a.html --motions own own", 1,
        "motions must be named, each once",
    ),
    Mistake(
        "fitted", "export capsules-lean --format page --out a.html --motions own own.npz", 1,
        "own and own.npz would both be called 'own'",
    ),
    Mistake(
        "fitted", "export capsules-lean --format page --out a.html --fps nan", 1,
        "fps: input should be a finite number",
    ),
    Mistake(
        "fitted", "export capsules-lean --format page --out a.html --seconds 1e300", 1,
        "are more than 100,000 frames; take fewer",
    ),
    Mistake(
        "fitted", "export capsules-lean --format page --out a.html --pictures -1", 1,
        "pictures: input should be greater than or equal to 0",
    ),
    Mistake(
        "fitted", "export capsules-lean --format page --out a.html --beside bob", 1,
        "no run 'bob' in params.yaml",
    ),
    Mistake("fitted", "view bob", 1, "no run 'bob' in params.yaml"),
    Mistake("fitted", "view unmade", 1, "no avatar/1 in data/fusion/unmade"),
    Mistake("fitted", "view capsules-lean --motions fly.bvh", 1, "no motion file fly.bvh"),
    Mistake("fitted", "view capsules-lean --port -1", 1, "--port -1: wanted 0"),
    Mistake("fitted", "view capsules-lean --port 99999", 1, "--port 99999: wanted 0"),
    Mistake("fitted", "view capsules-lean --port http", 2, "--port: invalid int value: 'http'"),
    Mistake("anywhere", "completion", 2, "the following arguments are required: shell"),
    Mistake("anywhere", "completion tcsh", 2, "invalid choice: 'tcsh' (choose from 'bash'"),
]  # fmt: skip


@pytest.fixture
def places(tmp_path, monkeypatch, request):
    """Goes to where a mistake is made; nothing is reproduced, whatever is asked for."""

    def nothing_runs(words, *_):
        raise AssertionError(f"would have run {words}")

    monkeypatch.setattr(running_dvc, "finish", nothing_runs)
    monkeypatch.setattr(running_dvc, "refresh", lambda folder: [])

    ending = ExitStack()

    def go(where):
        if where == "a checkout":
            monkeypatch.chdir(ROOT)
            return
        folder = request.getfixturevalue("project") if where == "fitted" else tmp_path
        monkeypatch.chdir(folder)
        (folder / "notes.txt").write_text("no video")
        (folder / "empty.mp4").touch()
        (folder / "texts").mkdir()
        if where == "broken":
            (folder / "params.yaml").write_text("runs: [")
        if where == "anywhere":
            write_video(folder / "clip.mp4", [picture(index) for index in range(3)])
            for place in (folder / "mine.mp4", folder / "closed"):
                place.mkdir() if place.suffix == "" else shutil.copy("clip.mp4", place)
                place.chmod(0)
                ending.callback(place.chmod, 0o700)
            ending.enter_context(ordinary_user())

    with ending:
        yield go


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.typed or "nothing")
def test_a_mistake_is_told_in_one_line(mistake, places, capsys):
    places(mistake.where)
    logging.root.handlers.clear()
    try:
        code = main(shlex.split(mistake.typed))
    except SystemExit as end:
        code = end.code
    said = capsys.readouterr().err
    assert code == mistake.code
    assert mistake.said in said.splitlines()[-1]
    assert len(said.splitlines()) == 1 or code == 2


@pytest.mark.parametrize("name", COMMANDS)
def test_every_argument_has_its_mistake(name):
    typed = [mistake.typed for mistake in MISTAKES if mistake.typed.split()[:1] == [name]]
    missing = [
        option.name
        for option in options_of(name)
        if option.name not in ("", "--help") and not any(option.name in text for text in typed)
    ]
    assert typed
    assert missing == []


def test_the_manual_has_the_same_table():
    row = r"^\| `deblur-avatar ?(.*?)` \| (.*?) \| (\d) \| (.*?) \|$"
    rows = re.findall(row, MANUAL.read_text(), re.MULTILINE)
    wanted = [(m.typed, m.where, str(m.code), m.said) for m in MISTAKES]
    assert rows == wanted
