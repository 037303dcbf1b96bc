import subprocess
from pathlib import Path

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


def test_folders_whose_tests_begin_first_are_there():
    assert all((ROOT / "tests" / name).is_dir() for name in FIRST)
