"""A stage that Ctrl-C stops says so in one line, leaves nothing half, and goes on when asked."""

import os
import signal
import subprocess
import sys

import pytest
from ruamel.yaml import YAML

from deblur_avatar.ending import STOPPED, STOPPED_WORDS
from deblur_avatar.training import resume
from tests.stages.running import ROOT, fitting_options, run_script, words

# What a shell starts in the background ignores the signal, and so would all that it starts.
SAVING_ALWAYS = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "import runpy, sys; from deblur_avatar.training import resume\n"
    "resume.SAVE_EVERY_S = 0.0; sys.argv = sys.argv[1:]\n"
    "runpy.run_path(sys.argv[0], run_name='__main__')\n"
)


@pytest.fixture
def folder(tmp_path, observations, tiny_parameters):
    """A fit that takes minutes."""
    observations.save(tmp_path / "observations")
    ends = {"warmup": 50_000, "trajectory": 50_001, "fusion": 50_002}
    schedules = {"tiny": tiny_parameters["schedules"]["tiny"] | ends}
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(tiny_parameters | {"schedules": schedules}, file)
    return tmp_path


def stopped_after(folder, iteration: int) -> tuple[int, str]:
    """Exit code and last words of a stage that is interrupted once it saved such an iteration."""
    options = words(fitting_options("warmup", folder, folder))
    quick = {"OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-c", SAVING_ALWAYS, "stages/warmup.py", *options],
        cwd=ROOT, env=os.environ | quick, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        while newest(folder) < iteration:
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, said = process.communicate()
    finally:
        process.kill()  # a fit of minutes, where something else went wrong
    return process.returncode, said


def newest(folder) -> int:
    """The iteration of the newest save; 0 while there is none, or one takes another's place."""
    try:
        saves = [path.name for path in (folder / ".warmup.unfinished").iterdir()]
    except FileNotFoundError:
        return 0
    return max(
        (int(name.removeprefix("after_")) for name in saves if name.startswith("after_")), default=0
    )


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_stage_that_is_interrupted_says_so_and_goes_on(folder, monkeypatch):
    code, said = stopped_after(folder, 2)
    assert code == STOPPED == 130
    assert said.endswith(STOPPED_WORDS)
    assert "Traceback" not in said
    assert not (folder / "warmup").exists()
    assert not list(folder.glob("*.json"))
    before = newest(folder)
    monkeypatch.setattr(resume, "SAVE_EVERY_S", 0.0)
    monkeypatch.setattr(resume.RunFolder, "save", interrupted)
    again = run_script("warmup", **fitting_options("warmup", folder, folder))
    assert again.returncode == STOPPED
    assert f"going on after iteration {before}\n" in again.stderr
