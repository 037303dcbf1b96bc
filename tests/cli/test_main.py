import importlib
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from deblur_avatar.cli import main as command
from deblur_avatar.cli.main import COMMANDS, main
from deblur_avatar.ending import STOPPED, STOPPED_WORDS

ROOT = Path(__file__).parents[2]


def test_the_command_is_installed_with_the_package():
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert scripts == {"deblur-avatar": f"{command.__name__}:main"}


def test_every_subcommand_is_a_module_and_every_module_one():
    others = {"__init__", "main", "running_dvc", "homes", "avatar_params", "footage_contents",
        "run_on_disk", "shelf", "shared_bodies", "unlisted_remote", "locked_stages",
        "warm_python", "warm_stages"}  # fmt: skip
    assert {p.stem for p in (ROOT / "deblur_avatar/cli").glob("*.py")} - others == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_says_what_a_subcommand_does(name, capsys):
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert end.value.code == 0
    module = importlib.import_module(f"deblur_avatar.cli.{name}")
    assert module.__doc__.splitlines()[0] in capsys.readouterr().out


def test_the_manual_says_what_every_exit_code_means(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    said = capsys.readouterr().out
    assert all(f"\n  {code} " in said for code in (0, 1, 2, STOPPED))


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert (end.value.code, capsys.readouterr().out) == (0, f"deblur-avatar {declared}\n")


def test_an_interrupted_command_says_that_it_goes_on_and_ends_as_shells_expect(monkeypatch, capsys):
    def interrupted(asked):
        raise KeyboardInterrupt

    monkeypatch.setattr(
        command.importlib.import_module("deblur_avatar.cli.report"), "run", interrupted
    )
    assert main(["report"]) == 130
    assert "goes on where it stopped" in capsys.readouterr().err


def test_a_command_that_is_interrupted_while_torch_is_loaded_says_so_too():
    program = (
        "import sys, os, signal, importlib.abc\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Impatient(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'torch': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Impatient())\n"
        "from deblur_avatar.cli.main import main\n"
        "raise SystemExit(main(['export', 'x', '--format', 'ply', '--out', 'x.ply']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False,
        env={"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 130
    assert done.stderr == STOPPED_WORDS


def help_without_torch(*words: str) -> str:
    """What `--help` says; torch, which takes two seconds to load, is not loaded for it."""
    program = (
        "import sys; from deblur_avatar.cli.main import main\n"
        f"try: main({[*words, '--help']})\n"
        "finally: print('torch' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env={"PYTHONPATH": str(ROOT), "COLUMNS": "100"},
    )  # fmt: skip
    *said, loaded = done.stdout.splitlines()
    assert loaded == "False"
    return "\n".join(said)


def test_help_lists_all_subcommands_without_loading_torch():
    said = help_without_torch()
    assert all(f"    {name}" in said for name in COMMANDS)


@pytest.mark.parametrize("command", ["check", "sweep", "report", "completion"])
def test_commands_that_compute_nothing_themselves_do_without_torch(command):
    assert f"usage: deblur-avatar {command}" in help_without_torch(command)


@pytest.mark.parametrize(
    "words", ["", "magic", "export", "export x --format obj --out x", "video", "repro now"]
)
def test_bad_usage_ends_with_2(words, capsys):
    with pytest.raises(SystemExit) as end:
        main(words.split())
    assert end.value.code == 2
    assert "usage: deblur-avatar" in capsys.readouterr().err
