import signal
import subprocess
import sys

import pytest


def guarded(program: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "deblur_avatar.sweep.guard", sys.executable, "-c", program]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGABRT])
def test_a_guard_ends_as_its_command_did(number):
    done = guarded(f"import os; os.kill(os.getpid(), {int(number)})")
    assert done.returncode == -number
    assert done.stderr == ""


def test_exit_codes_are_passed_on():
    assert guarded("raise SystemExit(3)").returncode == 3
