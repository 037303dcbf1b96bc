"""A stage that is interrupted while its modules are loaded says so in one line."""

import ast
import importlib
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deblur_avatar import loading
from deblur_avatar.ending import STOPPED, STOPPED_WORDS
from deblur_avatar.pipeline.code import scripts

ROOT = Path(__file__).parents[1]
# What a shell starts in the background ignores the signal, and so would all that it starts.
IMPATIENT = (
    "import sys, os, runpy, signal, importlib.abc\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "class Impatient(importlib.abc.MetaPathFinder):\n"
    "    def find_spec(self, name, path, target=None):\n"
    "        if name == 'torch': os.kill(os.getpid(), signal.SIGINT)\n"
    "sys.meta_path.insert(0, Impatient())\n"
    "runpy.run_path(sys.argv[1], run_name='__main__')\n"
)


@pytest.mark.parametrize(
    "script", ["stages/warmup.py", "benchmarks/stress/stages/self_check_cases.py"]
)
def test_a_stage_that_is_interrupted_while_torch_is_loaded_says_so(script):
    done = subprocess.run(
        [sys.executable, "-c", IMPATIENT, script], cwd=ROOT, capture_output=True, text=True,
        check=False, env={"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == STOPPED
    assert done.stderr == STOPPED_WORDS


@pytest.mark.parametrize("script", scripts(ROOT), ids=lambda path: path.stem)
def test_every_script_loads_it_before_all_that_is_not_pythons_own(script):
    first = next(
        name
        for node in ast.parse(script.read_text()).body
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in [getattr(node, "module", None) or node.names[0].name]
        if name.partition(".")[0] not in sys.stdlib_module_names
    )
    assert first == "deblur_avatar.loading"


def test_a_program_that_loads_a_script_keeps_its_own_answer_to_interrupts():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        importlib.reload(loading)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
