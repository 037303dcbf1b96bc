"""The GPU's kernels on a machine without one: their sources as C++, called where a GPU would be.

`each.h` makes loops of what nvcc makes kernels of; all else is the source that a GPU runs. What is
left to a GPU are its threads' sums and that it is asked on the right stream.
"""

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from torch import Tensor

from deblur_avatar.rendering import native_calls
from deblur_avatar.rendering.native_build import UNCONTRACTED, load_library, pointers
from deblur_avatar.rendering.native_calls import Place

THREADS = 2


def places_of(module: ModuleType) -> Any:
    """A fixture: tests of a module's kernel run with that of the CPU, and with that of a GPU."""

    @pytest.fixture(params=["cpu", "gpu"])
    def place(request: pytest.FixtureRequest) -> Iterator[None]:
        with taken_for_a_gpu(module) if request.param == "gpu" else nullcontext():
            yield

    return place


def as_cpp(source: Path, what: str, defines: Sequence[str] = ()) -> ctypes.CDLL:
    """The library of a GPU's source, for the CPU."""
    return load_library(source, defines, ["-x", "c++", *UNCONTRACTED, "-fno-finite-math-only"])


def call(library: ctypes.CDLL, name: str, sizes: Sequence[int], *given: object) -> None:
    """As `native_calls.launch`, by threads of the CPU."""
    handed = [pointers(one)[0] if one is None or isinstance(one, Tensor) else one for one in given]
    getattr(library, name)(*map(ctypes.c_int64, sizes), ctypes.c_int(THREADS), *handed)


@contextmanager
def taken_for_a_gpu(module: ModuleType) -> Iterator[None]:
    """Float32 tensors on the CPU go through a module's kernel for a GPU."""

    def place_of(*tensors: Tensor) -> Place | None:
        return "cuda" if native_calls.place_of(*tensors) == "cpu" else None

    with pytest.MonkeyPatch.context() as patch:
        for name, stand_in in (
            ("place_of", place_of), ("cuda_library_or_none", as_cpp), ("launch", call),
        ):  # fmt: skip
            patch.setattr(module, name, stand_in)
        for name in ("_library", "_cuda_library"):
            if hasattr(module, name):
                patch.setattr(module, name, getattr(module, name).__wrapped__)
        yield
