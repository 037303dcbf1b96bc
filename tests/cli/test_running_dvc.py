import os
import signal
import subprocess
import sys
from pathlib import Path

from deblur_avatar.cli.running_dvc import finish

ROOT = Path(__file__).parents[2]
SLOW_TO_END = (
    "import signal, sys, time, pathlib\n"
    "def end(*_):\n"
    "    time.sleep(1); pathlib.Path('ended').touch(); sys.exit(7)\n"
    "signal.signal(signal.SIGINT, end)\n"
    "pathlib.Path('ready').touch(); time.sleep(60)\n"
)


def test_a_command_s_exit_code_is_told(tmp_path):
    assert finish([sys.executable, "-c", "raise SystemExit(5)"], {}, tmp_path) == 5


def test_an_interrupted_command_is_waited_for(tmp_path):
    """As a terminal does it: the signal reaches the whole group of processes."""
    program = (
        "import signal, sys; from pathlib import Path\n"
        "from deblur_avatar.cli.running_dvc import finish\n"
        # What a shell starts in the background ignores the signal, and so would all that it starts.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"try: finish([sys.executable, '-c', {SLOW_TO_END!r}], {{}}, Path())\n"
        "except KeyboardInterrupt: sys.exit(130 if Path('ended').exists() else 1)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, start_new_session=True,
    )  # fmt: skip
    while not (tmp_path / "ready").exists():
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait() == 130
