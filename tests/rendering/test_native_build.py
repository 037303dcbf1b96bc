import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deblur_avatar.rendering import native_build
from deblur_avatar.rendering.native_build import BuildError, load_library

pytestmark = pytest.mark.portable

SOURCE = 'extern "C" int answer() { return ANSWER; }\n'


@pytest.fixture(autouse=True)
def _needs_a_compiler():
    try:
        native_build.find_compiler()
    except BuildError as error:
        pytest.skip(str(error))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv(native_build.CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv(native_build.FLAGS_VARIABLE, raising=False)
    return tmp_path / "cache"


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "question.cpp"
    path.write_text(SOURCE)
    return path


def pretend_compiler(path: Path, script: str) -> str:
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


def is_running(pid: str) -> bool:
    state = Path(f"/proc/{pid}/stat")
    return state.exists() and ") Z " not in state.read_text()


def test_a_source_is_compiled_once_and_called(cache, source):
    assert load_library(source, ["ANSWER=42"]).answer() == 42
    (library,) = cache.iterdir()
    built = library.stat().st_mtime_ns
    assert load_library(source, ["ANSWER=42"]).answer() == 42
    assert library.stat().st_mtime_ns == built


def test_whatever_could_change_it_makes_another_library(cache, source, monkeypatch):
    load_library(source, ["ANSWER=1"])
    load_library(source, ["ANSWER=2"])
    assert len(list(cache.iterdir())) == 2
    source.write_text(SOURCE + "// a remark\n")
    load_library(source, ["ANSWER=2"])
    assert len(list(cache.iterdir())) == 3
    monkeypatch.setenv(native_build.FLAGS_VARIABLE, "-O1 -DEXTRA")
    load_library(source, ["ANSWER=2"])
    assert len(list(cache.iterdir())) == 4
    monkeypatch.setattr(native_build, "_processor", lambda: "another machine")
    load_library(source, ["ANSWER=2"])
    assert len(list(cache.iterdir())) == 5


def test_two_processes_may_build_at_once(cache, source):
    script = (  # without importing the package: a process then starts in no time
        "import runpy, sys; from pathlib import Path;"
        "load_library = runpy.run_path(sys.argv[1])['load_library'];"
        "print(load_library(Path(sys.argv[2]), ['ANSWER=7']).answer())"
    )
    command = [sys.executable, "-c", script, native_build.__file__, str(source)]
    running = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=dict(os.environ))
        for _ in range(2)
    ]
    assert [process.communicate()[0].strip() for process in running] == ["7", "7"]
    assert [path.suffix for path in cache.iterdir()] == [".so"]


def test_cxx_names_the_compiler(cache, source, tmp_path, monkeypatch):
    (name,) = native_build.find_compiler()
    log = tmp_path / "log"
    monkeypatch.setenv(
        "CXX", pretend_compiler(tmp_path / "mine", f'echo "$@" >> {log}; exec {name} "$@"')
    )
    assert load_library(source, ["ANSWER=3"]).answer() == 3
    assert "-DANSWER=3" in log.read_text()


def test_a_compiler_without_openmp_serves(cache, source, tmp_path, monkeypatch):
    (name,) = native_build.find_compiler()
    refuse = f'case "$*" in *-fopenmp*) exit 1;; esac; exec {name} "$@"'
    monkeypatch.setenv("CXX", pretend_compiler(tmp_path / "plain", refuse))
    assert load_library(source, ["ANSWER=4"]).answer() == 4


def test_a_missing_compiler_is_named(cache, source, monkeypatch):
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(BuildError, match="CXX names 'no-such-compiler'"):
        load_library(source, ["ANSWER=1"])
    monkeypatch.delenv("CXX")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(BuildError, match="no C.. compiler.*set CXX"):
        load_library(source, ["ANSWER=1"])


def test_what_the_compiler_says_is_passed_on(cache, source):
    with pytest.raises(BuildError, match="ANSWER"):
        load_library(source)
    assert list(cache.iterdir()) == []


def test_a_compiler_that_never_ends_is_stopped_with_all_it_started(
    cache, source, tmp_path, monkeypatch
):
    pid = tmp_path / "pid"
    monkeypatch.setenv(
        "CXX",
        pretend_compiler(
            tmp_path / "slow",
            f'case "$1" in --version) echo 1; exit;; esac; sleep 60 & echo $! > {pid}; wait',
        ),
    )
    monkeypatch.setattr(native_build, "COMPILE_TIMEOUT", 2)
    with pytest.raises(BuildError, match="took over 2 s"):
        load_library(source, ["ANSWER=1"])
    deadline = time.monotonic() + 5
    while is_running(pid.read_text().strip()) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not is_running(pid.read_text().strip())
    assert list(cache.iterdir()) == []


def test_libraries_are_kept_where_caches_belong(monkeypatch, tmp_path):
    monkeypatch.delenv(native_build.CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert native_build.cache_folder() == tmp_path / "deblur_avatar"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert native_build.cache_folder() == Path.home() / ".cache" / "deblur_avatar"


def test_a_header_that_is_included_changes_the_library(cache, source):
    source.write_text('#include "told.h"\n' + SOURCE)
    header = source.with_name("told.h")
    header.write_text("#define ANSWER 3\n")
    assert load_library(source).answer() == 3
    header.write_text("#define ANSWER 4\n")
    assert load_library(source).answer() == 4
    assert len(list(cache.iterdir())) == 2


def test_nvcc_is_looked_for_in_cuda_home_and_on_path(tmp_path, monkeypatch):
    for variable in ("CUDA_HOME", "CUDA_PATH"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(native_build, "USUAL_NVCC", str(tmp_path / "nowhere"))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BuildError, match="neither in CUDA_HOME nor on PATH"):
        native_build.find_nvcc()
    on_path = pretend_compiler(tmp_path / "nvcc", "exit 1")
    assert native_build.find_nvcc() == [on_path]
    (tmp_path / "cuda" / "bin").mkdir(parents=True)
    at_home = pretend_compiler(tmp_path / "cuda" / "bin" / "nvcc", "exit 1")
    monkeypatch.setenv("CUDA_HOME", str(tmp_path / "cuda"))
    assert native_build.find_nvcc() == [at_home]


def test_a_gpus_library_is_filed_by_its_chip(cache, source, tmp_path, monkeypatch):
    """Nvcc is pretended: it is called as it has to be, and builds with the compiler there is."""
    said = tmp_path / "said"
    compiler = " ".join(native_build.find_compiler())
    pretended = pretend_compiler(
        tmp_path / "nvcc",
        f'[ "$1" = --version ] && exit 0\necho "$@" >> {said}\nwhile [ "$1" != -o ]; do '
        f'last="$1"; case "$1" in -D*) define="$1";; esac; shift; done\n'
        f'exec {compiler} -shared -fPIC $define -x c++ "$last" -o "$2"',
    )
    monkeypatch.setattr(native_build, "find_nvcc", lambda: [pretended])
    for capability in ((9, 0), (8, 6), (9, 0)):
        library = native_build.load_cuda_library(source, ["ANSWER=5"], capability)
        assert library.answer() == 5
    calls = said.read_text().splitlines()
    assert len(calls) == 2
    assert "code=sm_90" in calls[0]
    assert "code=sm_86" in calls[1]
    assert all("-x cu" in line for line in calls)
