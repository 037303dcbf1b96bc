import platform
import subprocess
from pathlib import Path

from tests.conftest import FIRST

ROOT = Path(__file__).parents[2]


def commands(target: str) -> list[str]:
    """What `make` would run."""
    done = subprocess.run(
        ["make", "-n", target], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def test_continuous_integration_runs_numerical_tests_on_a_second_kind_of_cpu():
    assert (ROOT / ".ci/run").read_text().rstrip().endswith("\nmake test")
    portable = [line for line in commands("test") if line.endswith("-m portable")]
    assert len(portable) == 1
    assert portable[0] in commands("test-portable")
    if platform.machine() != "x86_64":
        return
    for limit in ("ATEN_CPU_CAPABILITY=avx2", "ONEDNN_MAX_CPU_ISA=AVX2", "-march=x86-64-v3"):
        assert limit in portable[0]


def test_folders_whose_tests_begin_first_are_there():
    assert all((ROOT / "tests" / name).is_dir() for name in FIRST)
