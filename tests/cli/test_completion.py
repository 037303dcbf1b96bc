import contextlib
import io
import os
import pty
import re
import select
import shutil
import subprocess
import time

import pytest

from deblur_avatar.cli.main import COMMANDS, main
from tests.exports.requirement import missing


@pytest.fixture(scope="module")
def scripts():
    """What is printed for each shell."""
    found = {}
    for shell in ("bash", "zsh", "fish"):
        with contextlib.redirect_stdout(io.StringIO()) as said:
            assert main(["completion", shell]) == 0
        found[shell] = said.getvalue()
    return found


def needed(shell: str) -> None:
    if shutil.which(shell) is None:
        missing(f"no {shell}; apt-get install {shell}")


def completed(script: str, line: str) -> set[str]:
    """What bash offers for the last word of a line."""
    words = line.split(" ")
    program = (
        f"{script}\nCOMP_WORDS=({' '.join(word or chr(39) * 2 for word in words)})\n"
        f"COMP_CWORD={len(words) - 1}\n_deblur_avatar\nprintf '%s\\n' \"${{COMPREPLY[@]}}\""
    )
    done = subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("deblur-avatar vi", {"video", "view"}),
        ("deblur-avatar video --sch", {"--schedule"}),
        ("deblur-avatar export x --format gl", {"gltf_rig", "gltf_splats"}),
        ("deblur-avatar completion z", {"zsh"}),
        ("deblur-avatar video cl", set()),  # files
    ],
)
def test_bash_completes_commands_options_and_choices(scripts, line, offered):
    assert completed(scripts["bash"], line) == offered


def test_bash_knows_every_command(scripts):
    assert completed(scripts["bash"], "deblur-avatar ") == {*COMMANDS, "--help", "--version"}


def test_zsh_takes_the_function_of_bash(scripts):
    assert scripts["zsh"].startswith("#compdef deblur-avatar\n")
    assert scripts["bash"] in scripts["zsh"]


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("deblur-avatar vid", "deblur-avatar video "),
        ("deblur-avatar video --sch", "deblur-avatar video --schedule "),
        ("deblur-avatar export x --format gl", "deblur-avatar export x --format gltf_"),
    ],
)
def test_zsh_completes_at_the_first_tab(scripts, line, shown, tmp_path):
    needed("zsh")
    (tmp_path / "_deblur-avatar").write_text(scripts["zsh"])
    assert shown in after_a_tab(tmp_path, line, shown)


def after_a_tab(folder, line, wanted):
    """What zsh shows after a line and one Tab, up to what is wanted, or within 20 s."""
    process, terminal = pty.fork()
    if process == 0:
        os.environ.update(TERM="dumb", HOME=str(folder))
        os.execvp("zsh", ["zsh", "-f", "-i"])

    def seen(wanted):
        said, end = "", time.monotonic() + 20
        while wanted not in re.sub("[\a\r]", "", said) and time.monotonic() < end:
            if select.select([terminal], [], [], 0.1)[0]:
                said += os.read(terminal, 65536).decode(errors="replace")
        return re.sub("[\a\r]", "", said)

    begin = f"fpath=({folder} $fpath); autoload -Uz compinit; compinit -u -D; print rea''dy\n"
    try:
        os.write(terminal, f"PROMPT=; {begin}".encode())
        seen("ready")
        os.write(terminal, f"{line}\t".encode())
        return seen(wanted)
    finally:
        os.close(terminal)  # which ends it
        os.waitpid(process, 0)


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("deblur-avatar vi", {"video", "view"}),
        ("deblur-avatar video --sch", {"--schedule"}),
        ("deblur-avatar export x --format gl", {"gltf_rig", "gltf_splats"}),
        ("deblur-avatar completion z", {"zsh"}),
    ],
)
def test_fish_completes_commands_options_and_choices(scripts, line, offered, tmp_path):
    needed("fish")
    (tmp_path / "script").write_text(scripts["fish"])
    asked = f"source {tmp_path}/script; complete -C '{line}'"
    done = subprocess.run(
        ["fish", "--no-config", "-c", asked],
        capture_output=True, text=True, check=True, env=os.environ | {"HOME": str(tmp_path)},
    )  # fmt: skip
    assert {said.partition("\t")[0] for said in done.stdout.splitlines()} == offered


def test_fish_has_a_line_for_every_command_and_option(scripts):
    lines = scripts["fish"].splitlines()
    assert sum("__fish_use_subcommand" in line for line in lines) == len(COMMANDS)
    (line,) = [line for line in lines if "from export'" in line and "-l format" in line]
    assert " -x -a '" in line
    assert "gltf_rig" in line
    assert all(line.startswith("complete -c deblur-avatar -n ") for line in lines)


def test_each_line_for_fish_is_one_command_of_known_options_and_closed_quotes(scripts):
    """By the rules of its manual: within single quotes a backslash escapes itself and a quote."""
    quoted, bare = r"'(?:[^'\\]|\\['\\])*'", r"[\w.,:-]+"
    word = f"(?:{quoted}|{bare})"
    options = rf"-[nadlc] {word}|-[fx]"
    for line in scripts["fish"].splitlines():
        assert re.fullmatch(rf"complete(?: (?:{options}))+", line), line
    for line in ("complete -c a -d 'it's'", "complete -c a; b", "complete -c a -q b"):
        assert not re.fullmatch(rf"complete(?: (?:{options}))+", line)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_reads_its_script(scripts, shell, tmp_path):
    needed(shell)
    path = tmp_path / "script"
    path.write_text(scripts[shell])
    done = subprocess.run([shell, "-n", path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
