"""Native kernels: compiled where they run on first use, kept for the next.

Those of the CPU by its C++ compiler, those of a GPU by nvcc, from sources that may share headers.

The library is filed under everything that could change it (source, flags, compiler, processor), so
it never needs to be invalidated, and written to a temporary folder first, so that two processes may
build at once.
"""

import ctypes
import hashlib
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from torch import Tensor

# Overrides where libraries are kept.
CACHE_VARIABLE: Final = "DEBLUR_AVATAR_CACHE"

# Further compiler flags: sanitizers, other instruction sets.
FLAGS_VARIABLE: Final = "DEBLUR_AVATAR_KERNEL_FLAGS"

# Of what `-ffast-math` turns on, the parts that let minima, comparisons and square roots become
# single instructions. Never `-ffast-math` itself: gcc before 13 then links start-up code that
# flushes denormal numbers to zero for the whole process.
FLAGS: Final = (
    *("-std=c++17", "-O3", "-march=native", "-shared", "-fPIC"),
    *("-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-ffinite-math-only"),
)
OPENMP: Final = "-fopenmp"
# For kernels whose sums are to be torch's to the last bit: no product and sum in one rounding.
UNCONTRACTED: Final = ("-ffp-contract=off",)

# For a GPU; sums are not contracted, as on the CPU.
CUDA_FLAGS: Final = (
    *("-x", "cu", "-std=c++17", "-O3", "--extended-lambda", "-fmad=false"),
    *("-shared", "-Xcompiler", "-fPIC"),
)
USUAL_NVCC: Final = "/usr/local/cuda/bin"

COMPILE_TIMEOUT = 600  # seconds; it takes three, with sanitizers thirty, on a busy machine more


class BuildError(RuntimeError):
    """No compiler, or one that cannot compile the source."""


class _CompilerError(BuildError):
    """The compiler refuses the source or a flag."""


def pointers(*tensors: Tensor | None) -> list[ctypes.c_void_p]:
    """Where contiguous tensors begin, for a library's arguments; null for None."""
    return [ctypes.c_void_p(None if t is None else t.data_ptr()) for t in tensors]


def load_library(
    source: Path, defines: Sequence[str] = (), further: Sequence[str] = ()
) -> ctypes.CDLL:
    """Compile a C++ source, unless that has been done before, and load it.

    Args:
        source: one file with a plain C interface; what it includes lies beside it.
        defines: preprocessor definitions, `NAME=value`.
        further: flags of this kernel alone.

    Raises:
        BuildError: there is no compiler, or it fails; with what it said.
    """
    compiler = find_compiler()
    flags = [*FLAGS, *further, *(f"-D{define}" for define in defines)]
    flags += shlex.split(os.environ.get(FLAGS_VARIABLE, ""))
    library = _place(source, compiler, flags)
    if not library.exists():
        try:
            _compile(source, compiler, [*flags, OPENMP], library)
        except _CompilerError:
            # Some compilers come without OpenMP; one thread is better than none.
            _compile(source, compiler, flags, library)
    return ctypes.CDLL(str(library))


def load_cuda_library(
    source: Path, defines: Sequence[str] = (), capability: tuple[int, int] = (0, 0)
) -> ctypes.CDLL:
    """The same of a source for a GPU.

    Args:
        source: CUDA C++, or C++ that uses `each.h`.
        defines: as above.
        capability: the GPU's compute capability.

    Raises:
        BuildError: there is no nvcc, or it fails; with what it said.
    """
    compiler, chip = find_nvcc(), "".join(map(str, capability))
    flags = [*CUDA_FLAGS, f"-gencode=arch=compute_{chip},code=sm_{chip}"]
    flags += [f"-D{define}" for define in defines]
    library = _place(source, compiler, flags)
    if not library.exists():
        _compile(source, compiler, flags, library)
    return ctypes.CDLL(str(library))


def library_or_none(
    source: Path, what: str, defines: Sequence[str] = (), further: Sequence[str] = ()
) -> ctypes.CDLL | None:
    """The same, of a kernel that has a twin in plain torch: None and a warning if it cannot be had.

    Args:
        source: as above.
        what: is done in plain torch then; begins the warning.
        defines: as above.
        further: as above.
    """
    try:
        return load_library(source, defines, further)
    except BuildError as error:
        warn_of_plain_torch(what, error)
        return None


def warn_of_plain_torch(what: str, error: BuildError) -> None:
    """Say that a kernel's slow twin takes over, and why."""
    warnings.warn(f"{what} in plain torch, slowly: {error}", stacklevel=4)


def find_compiler() -> list[str]:
    """Find the C++ compiler: `CXX`, or what the system calls one.

    Raises:
        BuildError: there is none.
    """
    if named := os.environ.get("CXX"):
        command = shlex.split(named)
        if shutil.which(command[0]) is None:
            raise BuildError(f"CXX names {command[0]!r}, which is not a program on PATH")
        return command
    for name in ("c++", "g++", "clang++"):
        if shutil.which(name):
            return [name]
    raise BuildError("no C++ compiler: none of c++, g++, clang++ is on PATH; set CXX to yours")


def find_nvcc() -> list[str]:
    """Find CUDA's compiler: in `CUDA_HOME` or `CUDA_PATH`, on PATH, or where it usually lies.

    Raises:
        BuildError: there is none.
    """
    homes = [os.environ.get("CUDA_HOME"), os.environ.get("CUDA_PATH")]
    places = [*(str(Path(home) / "bin") for home in homes if home), None, USUAL_NVCC]
    for place in places:
        if found := shutil.which("nvcc", path=place):
            return [found]
    raise BuildError("no nvcc: neither in CUDA_HOME nor on PATH; install CUDA's compiler")


def cache_folder() -> Path:
    """Say where libraries are kept."""
    if folder := os.environ.get(CACHE_VARIABLE):
        return Path(folder)
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "deblur_avatar"


def _compile(source: Path, compiler: list[str], flags: list[str], library: Path) -> None:
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        # Beside its final place: a move within one file system is atomic.
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            built = Path(folder) / library.name
            _run([*compiler, *flags, str(source), "-o", str(built)])
            built.replace(library)
    except OSError as error:
        raise BuildError(f"cannot build {source.name}: {error}") from error


def _run(command: list[str]) -> None:
    # What is preloaded into this process, a sanitizer say, is not meant for the compiler.
    environment = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
    # The compiler starts processes of its own; in a session of its own all can be stopped at once.
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True
    ) as process:
        try:
            _, said = process.communicate(timeout=COMPILE_TIMEOUT)
        except BaseException as error:
            os.killpg(process.pid, signal.SIGKILL)
            if isinstance(error, subprocess.TimeoutExpired):
                raise BuildError(f"{shlex.join(command)} took over {COMPILE_TIMEOUT} s") from error
            raise
    if process.returncode != 0:
        raise _CompilerError(f"{shlex.join(command)} failed:\n{said}")


def _place(source: Path, compiler: list[str], flags: list[str]) -> Path:
    """Where the library is filed, by all that could change it."""
    texts = [path.read_text() for path in _with_included(source)]
    parts = [*texts, *compiler, *flags, OPENMP, _version(compiler), _processor()]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]
    return cache_folder() / f"{source.stem}-{key}.so"


def _with_included(source: Path) -> list[Path]:
    """A source and the headers of its own that it includes, each once."""
    found = [source]
    for path in found:  # grows on the way
        for name in re.findall(r'^#include "([^"]+)"', path.read_text(), re.MULTILINE):
            header = (path.parent / name).resolve()
            if header not in found:
                found.append(header)
    return found


def _version(compiler: list[str]) -> str:
    try:
        command = [*compiler, "--version"]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        raise BuildError(f"{shlex.join(command)} failed: {error}") from error


def _processor() -> str:
    """What `-march=native` looks at: a home folder may be shared by different machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    told = {"model name", "flags", "Features", "CPU implementer", "CPU part"}
    return "\n".join(sorted({line for line in lines if line.split("\t")[0].strip() in told}))
