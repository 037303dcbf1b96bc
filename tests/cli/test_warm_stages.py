"""Scripts run warm: as Python itself would run them, but for what is loaded already."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from deblur_avatar.cli import warm_python
from deblur_avatar.cli.warm_stages import warmed

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere Python starts anew")

TELLS = """
import json, os, sys
loaded = sorted(sys.modules)
import beside
json.dump({
    "words": sys.argv, "folder": os.getcwd(), "name": __name__, "file": __file__,
    "variable": os.environ.get("VARIABLE"), "variables": len(os.environ), "beside": beside.VALUE,
    "torch": "torch" in loaded, "ours": [name for name in loaded if name.startswith("deblur")],
    "read": sys.stdin.read(),
}, sys.stdout)
"""
WAITS = """
import os, sys, time
open(sys.argv[1], "w").write(str(os.getpid()))
heard = 0
while True:
    try:
        time.sleep(60 if not heard else 1)
        sys.exit(40 + heard)
    except KeyboardInterrupt:
        heard += 1
"""


@pytest.fixture(scope="module")
def environment() -> Mapping[str, str]:
    """Variables by which `python` is warm."""
    return warmed(os.environ)


@pytest.fixture
def quick(tmp_path: Path) -> dict[str, str]:
    """Variables with which a server of its own loads libraries of nothing, in no time."""
    folder = tmp_path / "libraries"
    for name in ("torch", "cv2", "scipy"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").touch()
    return {**os.environ, "PYTHONPATH": str(folder)}


@pytest.fixture
def script(tmp_path: Path) -> Callable[[str], Path]:
    """Write a script beside a module that it can import."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts/beside.py").write_text("VALUE = 5\n")

    def write(text: str) -> Path:
        path = tmp_path / "scripts/script.py"
        path.write_text(text)
        return path

    return write


def test_a_script_finds_what_python_would_give_it(
    environment: Mapping[str, str], script: Callable[[str], Path], tmp_path: Path
) -> None:
    path = script(TELLS)

    def told(given: Mapping[str, str]) -> dict[str, object]:
        done = subprocess.run(
            ["python", path, "--word", "a b"], env={**given, "VARIABLE": "é\n"}, cwd=tmp_path,
            input="asked", capture_output=True, text=True, check=True,
        )  # fmt: skip
        return dict(json.loads(done.stdout))

    here = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    warm, cold = told(environment), told({**os.environ, "PATH": here})
    assert warm.pop("torch")
    assert not cold.pop("torch")
    assert set(warm.pop("ours")) <= {  # type: ignore[call-overload]
        "deblur_avatar", "deblur_avatar.cli", "deblur_avatar.cli.warm_python",
    }  # fmt: skip
    assert cold.pop("ours") == []
    assert warm == cold


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("raise SystemExit", 0, ""),
        ("raise SystemExit(7)", 7, ""),
        ("raise SystemExit('words')", 1, "words\n"),
        ("raise ValueError('odd')", 1, "ValueError: odd\n"),
        ("raise KeyboardInterrupt", 130, "KeyboardInterrupt\n"),
        ("raise SystemExit(258)", 2, ""),
        (
            "import threading, time; "
            "threading.Thread(target=lambda: (time.sleep(0.5), open('left', 'w'))).start()",
            0,
            "",
        ),
        ("print('out', end='')", 0, ""),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", 137, "else runs on it\n"),
        ("import atexit; atexit.register(lambda: open('left', 'w'))", 0, ""),
    ],
)
def test_a_script_ends_as_python_would_end_it(
    environment: Mapping[str, str],
    script: Callable[[str], Path],
    tmp_path: Path,
    text: str,
    code: int,
    said: str,
) -> None:
    done = subprocess.run(
        ["python", script(text)], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == code
    assert done.stderr.endswith(said)
    assert bool(done.stderr) == bool(said)
    assert done.stdout == ("out" if "out" in text else "")
    assert (tmp_path / "left").exists() == ("left" in text)


def _pid(path: Path) -> int:
    for _ in range(1000):
        if path.is_file() and path.read_text():
            return int(path.read_text())
        time.sleep(0.01)
    raise AssertionError("the script did not begin")


def _fields(pid: int) -> tuple[str, int]:
    """A process's state and its parent."""
    state, parent, *_ = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return state, int(parent)


def _is_there(pid: int) -> bool:
    """Whether a process still runs; one that waits to be reaped does not."""
    for _ in range(200):
        try:
            if _fields(pid)[0] == "Z":
                return False
        except OSError:
            return False
        time.sleep(0.01)
    return True


STARTS = (
    "import os, signal, subprocess, sys\n"
    "from deblur_avatar.cli.warm_stages import warmed\n"
    "signal.signal(signal.SIGINT, lambda *_: None)\n"
    "signal.signal(signal.SIGTERM, lambda *_: None)\n"
    "with subprocess.Popen(['python', *sys.argv[1:]], env=warmed(os.environ)) as client:\n"
    "    open('client', 'w').write(str(client.pid))\n"
    "    sys.exit(client.wait() % 256)\n"
)


@pytest.mark.parametrize(
    ("number", "everybody", "code"),
    [
        (signal.SIGINT, True, 41),
        (signal.SIGINT, False, 41),
        (signal.SIGTERM, False, 143),
        (signal.SIGKILL, False, 256 - signal.SIGKILL),
    ],
)
def test_a_signal_reaches_the_script_once(
    script: Callable[[str], Path],
    quick: Mapping[str, str],
    tmp_path: Path,
    number: int,
    everybody: bool,
    code: int,
) -> None:
    """Sent to the client, or to its whole group, the server's too, as a terminal does it."""
    words = [sys.executable, "-c", STARTS, str(script(WAITS)), "pid"]
    with subprocess.Popen(words, cwd=tmp_path, env=quick, start_new_session=True) as began:
        pid = _pid(tmp_path / "pid")
        client = _pid(tmp_path / "client")
        assert os.getpgid(pid) != os.getpgid(client)
        os.killpg(began.pid, number) if everybody else os.kill(client, number)
        assert began.wait(30) == code
    assert not _is_there(pid)


def test_a_signal_that_comes_while_the_server_loads_waits_for_the_script(
    script: Callable[[str], Path], quick: Mapping[str, str], tmp_path: Path
) -> None:
    (tmp_path / "libraries/torch/__init__.py").write_text("import time; time.sleep(2)\n")
    text = "import time\ntime.sleep(20)\nopen('done', 'w')\n"
    words = [sys.executable, "-c", STARTS, str(script(text))]
    with subprocess.Popen(words, cwd=tmp_path, env=quick, start_new_session=True) as began:
        _pid(tmp_path / "client")
        time.sleep(0.5)  # the client has asked, and torch takes seconds
        os.killpg(began.pid, signal.SIGINT)
        assert began.wait(15) == 130
    assert not (tmp_path / "done").exists()


def test_a_script_stands_still_while_its_client_does(
    environment: Mapping[str, str], script: Callable[[str], Path], tmp_path: Path
) -> None:
    words = ["python", str(script(WAITS)), str(tmp_path / "pid")]
    with subprocess.Popen(words, env=environment, start_new_session=True) as client:
        pid = _pid(tmp_path / "pid")
        for number, state in ((signal.SIGTSTP, "T"), (signal.SIGCONT, "S")):
            os.killpg(client.pid, number)
            for _ in range(500):
                if _fields(pid)[0] == state:
                    break
                time.sleep(0.01)
            assert _fields(pid)[0] == state
        client.terminate()
        assert client.wait(20) == 143


def test_a_script_ends_with_what_relays_to_it(
    environment: Mapping[str, str], script: Callable[[str], Path], tmp_path: Path
) -> None:
    with subprocess.Popen(["python", script(WAITS), tmp_path / "pid"], env=environment) as client:
        pid = _pid(tmp_path / "pid")
        os.kill(_fields(pid)[1], signal.SIGKILL)
        assert client.wait(20) == 137
    assert not _is_there(pid)


def test_a_background_that_does_not_hear_ctrl_c_goes_on(
    environment: Mapping[str, str], script: Callable[[str], Path], tmp_path: Path
) -> None:
    text = "import signal, sys; sys.exit(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"
    command = f"trap '' INT; python {script(text)}"
    assert subprocess.run(["sh", "-c", command], env=environment).returncode == 1
    deaf = signal.getsignal(signal.SIGINT) is signal.SIG_IGN  # the tests may be a background, too
    assert subprocess.run(["python", script(text)], env=environment).returncode == deaf


def test_without_a_server_python_itself_runs(script: Callable[[str], Path], tmp_path: Path) -> None:
    client = [sys.executable, "-IS", warm_python.__file__, str(tmp_path / "none"), sys.executable]
    done = subprocess.run([*client, script("import sys; sys.exit(9)")])
    assert done.returncode == 9
    assert subprocess.run([*client, "-c", "raise SystemExit(8)"]).returncode == 8


@pytest.mark.parametrize(
    ("words", "code"), [(["-c", "raise SystemExit(8)"], 8), (["none.py"], 2), (["-V"], 0)]
)
def test_what_is_no_script_is_python_s(
    environment: Mapping[str, str], words: list[str], code: int
) -> None:
    assert subprocess.run(["python", *words], env=environment).returncode == code


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-"])
def test_a_closed_stream_is_no_obstacle(
    environment: Mapping[str, str], script: Callable[[str], Path], closed: str
) -> None:
    command = f"python {script('raise SystemExit(6)')} {closed}"
    assert subprocess.run(["sh", "-c", command], env=environment).returncode == 6


def test_without_libraries_stages_say_so_themselves(
    script: Callable[[str], Path], tmp_path: Path
) -> None:
    (tmp_path / "torch.py").write_text("raise OSError('no such driver')\n")
    words = [sys.executable, "-c", STARTS, str(script("import torch"))]
    given = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(words, cwd=tmp_path, env=given, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.endswith("OSError: no such driver\n")


def test_a_server_that_is_killed_leaves_stages_to_python(
    script: Callable[[str], Path], quick: Mapping[str, str], tmp_path: Path
) -> None:
    (tmp_path / "libraries/torch/__init__.py").write_text("import time; time.sleep(20)\n")
    text = STARTS.replace(
        "    sys.exit(", "    os.system('sleep 0.5; pkill -KILL -f deblur_avatar.cli.warm_stages.*'"
        " + str(os.getpid()))\n    sys.exit("
    )  # fmt: skip
    words = [sys.executable, "-c", text, str(script("import sys; sys.exit(9)"))]
    assert subprocess.run(words, cwd=tmp_path, env=quick).returncode == 9


def test_the_server_ends_with_the_process_that_began_it(
    quick: Mapping[str, str], tmp_path: Path
) -> None:
    text = (
        "import os, subprocess, sys, time\n"
        "from deblur_avatar.cli.warm_stages import warmed\n"
        "environment = warmed(os.environ)\n"
        "subprocess.run(['python', 'pids.py'], env=environment, check=True)\n"
        "time.sleep(60)\n"
    )
    (tmp_path / "pids.py").write_text(
        "import os\n"
        "handler = os.getppid()\n"
        "stat = open(f'/proc/{handler}/stat').read().rpartition(')')[2].split()\n"
        "open('part', 'w').write(stat[1])\n"
        "os.replace('part', 'pid')\n"
    )
    (tmp_path / "tqdm.py").write_text("raise SystemExit('not of the library')\n")
    with TemporaryDirectory() as scratch:  # a socket's path is no longer than 107 letters
        given = {**quick, "TMPDIR": scratch}
        with subprocess.Popen([sys.executable, "-c", text], cwd=tmp_path, env=given) as began:
            server = _pid(tmp_path / "pid")
            assert _is_there(server)
            assert len(list(Path(scratch).glob("deblur-avatar-*"))) == 1
            began.kill()
        assert not _is_there(server)
        assert list(Path(scratch).glob("deblur-avatar-*")) == []
