import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

from tests.conftest import FIRST

ROOT = Path(__file__).parents[2]


def commands(target: str, *settings: str) -> list[str]:
    """What `make` would run."""
    done = subprocess.run(
        ["make", "-n", target, *settings], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def portable(*settings: str) -> list[str]:
    """The runs of portable tests that `make test` ends in."""
    return [line for line in commands("test", *settings) if line.endswith("-m portable")]


def test_continuous_integration_runs_numerical_tests_on_a_second_kind_of_cpu():
    assert (ROOT / ".ci/run").read_text().rstrip().endswith("\nmake test")
    (line,) = portable("WIDER=avx512f")
    assert line in commands("test-portable", "WIDER=avx512f")
    for limit in ("ATEN_CPU_CAPABILITY=avx2", "ONEDNN_MAX_CPU_ISA=AVX2", "-march=x86-64-v3"):
        assert limit in line


def test_a_cpu_that_has_no_more_than_the_second_kind_runs_them_once():
    assert portable("WIDER=") == []
    assert any(line.startswith("echo") for line in commands("test-portable", "WIDER="))
    cpu = Path("/proc/cpuinfo")
    wider = cpu.exists() and "avx512f" in cpu.read_text()
    assert len(portable()) == wider


@pytest.mark.parametrize("minor", [10, 11, 12, 13, 14])
def test_setup_takes_the_versions_of_python_that_the_package_does(tmp_path: Path, minor: int):
    version = tmp_path / "python"
    told = f"import sys; sys.version_info = (3, {minor}, 1); exec(sys.argv[2])"
    version.write_text(
        f'#!/bin/sh\ncase "$1" in\n-c) exec "{sys.executable}" -c "{told}" "$@" ;;\n'
        f"--version) echo Python 3.{minor}.1 ;;\n*) exit 7 ;;\nesac\n"
    )
    version.chmod(0o755)
    words = ["make", "setup", f"PYTHON={version}", f"STAMP={tmp_path / 'none'}"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    with (ROOT / "pyproject.toml").open("rb") as file:
        taken = SpecifierSet(tomllib.load(file)["project"]["requires-python"])
    refusal = f"python is Python 3.{minor}.1; set PYTHON=python3.12, say"
    assert done.returncode == 2
    assert ("Error 7" in done.stderr) == (f"3.{minor}.1" in taken) == (minor in (11, 12))
    assert (refusal in done.stdout) == (minor not in (11, 12))


def test_folders_whose_tests_begin_first_are_there():
    assert all((ROOT / "tests" / name).is_dir() for name in FIRST)
