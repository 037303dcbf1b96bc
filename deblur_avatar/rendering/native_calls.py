"""Calls of native kernels where the tensors are: on the CPU, or on a GPU.

Conventions. A function of a kernel for both takes its sizes, its `Place` (each.h) and pointers.
"""

import ctypes
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from deblur_avatar.rendering.native_build import (
    BuildError,
    load_cuda_library,
    warn_of_plain_torch,
)

Place = Literal["cpu", "cuda"]


def place_of(*tensors: Tensor) -> Place | None:
    """Where a kernel takes tensors: all float32, on the CPU or all on one GPU; None: nowhere."""
    devices = {tensor.device for tensor in tensors}
    alike = len(devices) == 1 and all(tensor.dtype == torch.float32 for tensor in tensors)
    kind = devices.pop().type if alike else None
    return "cuda" if kind == "cuda" else "cpu" if kind == "cpu" else None


def cuda_library_or_none(
    source: Path, what: str, defines: Sequence[str] = ()
) -> ctypes.CDLL | None:
    """The library of a kernel for the GPU at hand; None and a warning if it cannot be had.

    Args:
        source: CUDA C++, or C++ that uses `each.h`.
        what: is done in plain torch then; begins the warning.
        defines: preprocessor definitions, `NAME=value`.
    """
    try:
        library = load_cuda_library(source, defines, torch.cuda.get_device_capability())
    except BuildError as error:
        warn_of_plain_torch(what, error)
        return None
    library.launch_problem.restype = ctypes.c_char_p
    library.launch_problem.argtypes = []
    return library


def launch(
    library: ctypes.CDLL,
    name: str,
    sizes: Sequence[int],
    *given: Tensor | ctypes.Array[ctypes.c_double] | None,
) -> None:
    """Ask a GPU for a function of a kernel, on the stream of its tensors' device.

    Args:
        library: of the kernel.
        name: of the function.
        sizes: its whole numbers, which come first.
        given: contiguous tensors of one device, the first of them first; numbers on the host; or
            null.

    Raises:
        RuntimeError: the GPU refuses it, or refused something earlier.
    """
    device = next(one.device for one in given if isinstance(one, Tensor))
    handed = [ctypes.c_void_p(one.data_ptr()) if isinstance(one, Tensor) else one for one in given]
    # Entering the device that one is on already takes as long as the call itself.
    elsewhere = device.index != torch.cuda.current_device()
    with torch.cuda.device(device) if elsewhere else nullcontext():
        stream = ctypes.c_void_p(torch.cuda.current_stream().cuda_stream)
        getattr(library, name)(*map(ctypes.c_int64, sizes), stream, *handed)
        problem = library.launch_problem()
    if problem is not None:
        raise RuntimeError(f"the GPU refuses kernel {name!r}: {problem.decode()}")
