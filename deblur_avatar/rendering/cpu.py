"""CPU rasterizer: a native kernel, float32.

`kernel.cpp` says how it works. Here are its memory, which torch owns, and its place in autograd.
"""

import ctypes
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from deblur_avatar.rendering import conventions
from deblur_avatar.rendering.inputs import not_finite
from deblur_avatar.rendering.native_build import load_library
from deblur_avatar.rendering.result import Rasterization, ScreenStatistics
from deblur_avatar.run import kernel_threads

KERNEL: Final = Path(__file__).with_name("kernel.cpp")

# Pairs whose gradients wait in memory at once, if no single pose has more: 6 MB, a share of a
# common cache. More poses are then differentiated one group after the other.
SLOT_CAPACITY: Final = 2**17

# Bits in what `project` returns, and the argument each one blames.
_NOT_FINITE: Final = {1: "means", 2: "covars", 4: "opacities", 8: "colors"}
_TOO_MANY_PAIRS: Final = 16

_INTEGERS = (
    *("poses", "gaussians", "channels", "width", "height", "covar_columns", "covars_shared"),
    *("average", "depth", "keep", "threads", "chunks", "chunk_shift", "tiles_x", "tiles_y"),
    *("pairs", "busy", "largest", "slot_capacity"),
)
_POINTERS = (
    *("means", "covars", "opacities", "colors", "viewmat", "K", "background"),
    *("records", "placements", "radii", "histogram", "tile_start", "chunk_slot"),
    *("busy_index", "busy_start", "unsorted", "sorted", "busy_tiles", "composited"),
    *("visits", "states", "image", "alpha", "depths"),
    *("image_grad", "alpha_grad", "depths_grad", "slots"),
    *("means_grad", "covars_grad", "opacities_grad", "colors_grad", "background_grad"),
    *("means2d_grad", "means2d_absgrad"),
)


class Frame(ctypes.Structure):
    """Everything the kernel's calls share: `struct Frame` in kernel.cpp, field for field."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in _INTEGERS),
        ("eps2d", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in _POINTERS),
    ]

    def point(self, **tensors: Tensor | None) -> None:
        """Point fields at the memory of tensors, which the caller keeps alive."""
        for name, tensor in tensors.items():
            setattr(self, name, None if tensor is None else tensor.data_ptr())


class Kernel:
    """The compiled kernel."""

    def __init__(self) -> None:
        names = (
            *("NEAR_PLANE", "VIEW_MARGIN"),
            *("MAX_ALPHA", "MIN_ALPHA", "MIN_TRANSMITTANCE"),
        )
        library = load_library(KERNEL, [f"{name}={getattr(conventions, name)}f" for name in names])
        for name in ("project", "forward", "backward", "backward_background"):
            getattr(library, name).argtypes = [ctypes.POINTER(Frame)]
        for name in ("forward", "backward", "backward_background"):
            getattr(library, name).restype = None
        library.project.restype = ctypes.c_int64
        self.project, self.forward = library.project, library.forward
        self.backward, self.backward_background = library.backward, library.backward_background
        assert _constant(library, "frame_bytes") == ctypes.sizeof(Frame)
        self.lanes = _constant(library, "lanes")
        self.tile_width = _constant(library, "tile_width")
        self.tile_height = _constant(library, "tile_height")
        self.visits_bytes = _constant(library, "visits_bytes")
        self.visits_group = _constant(library, "visits_group")
        self.states_floats = [_constant(library, "states_floats", v) for v in range(6)]
        self.slot_floats = [_constant(library, "slot_floats", v) for v in range(6)]


def _constant(library: ctypes.CDLL, name: str, *arguments: int) -> int:
    function = getattr(library, name)
    function.restype = ctypes.c_int64
    function.argtypes = [ctypes.c_int64] * len(arguments)
    return int(function(*arguments))


@cache
def kernel() -> Kernel:
    """Compile and load the kernel, once a process.

    Raises:
        BuildError: there is no compiler, or it fails.
    """
    return Kernel()


def rasterize(
    means: Float[Tensor, "B N 3"],
    covars: Float[Tensor, "*rest N 3 3"] | Float[Tensor, "*rest N 6"],
    opacities: Float[Tensor, " N"],
    colors: Float[Tensor, "N C"],
    viewmat: Float[Tensor, "4 4"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
    *,
    background: Float[Tensor, " C"] | None,
    average: bool,
    depth: bool,
    eps2d: float,
) -> Rasterization:
    """Rasterize with the native kernel; see the package for the arguments.

    Raises:
        ValueError: the tensors are not float32 on the CPU, a value is NaN or infinite, or
            Gaussians and pixels are too many.
        BuildError: the kernel cannot be compiled.
    """
    if means.dtype != torch.float32 or means.device.type != "cpu":
        raise ValueError(
            f"the cpu backend computes in float32 on the CPU, got {means.dtype} on {means.device};"
            " backend='reference' takes any"
        )
    screen = ScreenStatistics()
    image, alpha, depths, radii = _Rasterize.apply(
        *(means, covars, opacities, colors, background),
        *(viewmat, K, width, height, average, depth, eps2d, screen),
    )
    return Rasterization(
        image=image, alpha=alpha, depth=depths if depth else None, radii=radii, screen=screen
    )


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        covars: Tensor,
        opacities: Tensor,
        colors: Tensor,
        background: Tensor | None,
        viewmat: Tensor,
        K: Tensor,
        width: int,
        height: int,
        average: bool,
        depth: bool,
        eps2d: float,
        screen: ScreenStatistics,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        native = kernel()
        inputs: dict[str, Tensor | None] = {
            "means": means.contiguous(),
            "covars": covars.contiguous(),
            "opacities": opacities.contiguous(),
            "colors": colors.contiguous(),
            "viewmat": viewmat.contiguous(),
            "K": K.contiguous(),
            "background": background.contiguous() if background is not None else None,
        }
        if background is not None and not bool(torch.isfinite(background).all()):
            raise ValueError(not_finite("background"))
        options = {"average": average, "depth": depth, "keep": any(ctx.needs_input_grad)}
        frame = _frame(native, inputs, width, height, options)
        frame.eps2d = eps2d
        work = _project(native, frame, inputs)

        pictures = 1 if average else frame.poses
        image = means.new_empty(pictures, height, width, frame.channels)
        alpha = means.new_empty(pictures, height, width)
        depths = means.new_empty(pictures, height, width) if depth else means.new_empty(0)
        work |= _compositing_work(native, frame, means)
        unsorted = _bytes(2 * 8 * frame.pairs)
        frame.point(**work, unsorted=unsorted, image=image, alpha=alpha, depths=depths)
        native.forward(frame)

        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(work["radii"])
        if frame.keep:
            tensors = (inputs[name] for name in ("means", "covars", "opacities", "colors"))
            ctx.save_for_backward(*tensors, inputs["background"], alpha)
            ctx.frame, ctx.screen = frame, screen
            ctx.inputs, ctx.work = (inputs["viewmat"], inputs["K"]), work
        return image, alpha, depths, work["radii"]

    @staticmethod
    @once_differentiable
    def backward(
        ctx: Any,
        image_grad: Tensor | None,
        alpha_grad: Tensor | None,
        depths_grad: Tensor | None,
        _radii_grad: None,
    ) -> tuple[Tensor | None, ...]:
        native = kernel()
        means, covars, opacities, colors, background, alpha = ctx.saved_tensors
        frame: Frame = ctx.frame
        given = {"image_grad": image_grad, "alpha_grad": alpha_grad, "depths_grad": depths_grad}
        given = {name: g.contiguous() for name, g in given.items() if g is not None}
        names = ("means_grad", "covars_grad", "opacities_grad", "colors_grad")
        made = {
            name: torch.empty_like(tensor) if needed else None
            for name, tensor, needed in zip(
                names, ctx.saved_tensors, ctx.needs_input_grad, strict=False
            )
        }
        grad, absgrad = means.new_empty(2, *means.shape[:2], 2)
        values = colors.shape[1] + frame.depth
        frame.slot_capacity = max(frame.largest, min(frame.pairs, SLOT_CAPACITY))
        slots = means.new_empty((frame.slot_capacity + 1) * native.slot_floats[values])
        frame.point(image_grad=None, alpha_grad=None, depths_grad=None)
        frame.point(**given, **made, slots=slots, means2d_grad=grad, means2d_absgrad=absgrad)
        native.backward(frame)
        background_grad = None
        if ctx.needs_input_grad[4] and image_grad is not None:
            background_grad = torch.empty_like(background)
            frame.point(background_grad=background_grad)
            native.backward_background(frame)
        ctx.screen.add(grad, absgrad)
        return (*made.values(), background_grad, *(None,) * 8)


def _frame(
    native: Kernel,
    inputs: Mapping[str, Tensor | None],
    width: int,
    height: int,
    options: Mapping[str, bool],
) -> Frame:
    """Sizes of one call: pictures, tiles, and how the work is cut for threads."""
    means, covars, colors = inputs["means"], inputs["covars"], inputs["colors"]
    assert means is not None
    assert covars is not None
    assert colors is not None
    B, N = len(means), means.shape[1]
    tiles_x = -(-width // native.tile_width)
    tiles_y = -(-height // native.tile_height)
    if max(tiles_x, tiles_y) >= 2**15 or N >= 2**31 or B * tiles_x * tiles_y >= 2**31:
        raise ValueError(f"too much for the cpu backend: {B} x {N} Gaussians, {width}x{height}")
    threads = kernel_threads()
    # Some chunks a thread even out their work; each needs a counter per tile.
    shift = max((max(N, 1) * B // (4 * threads)).bit_length(), 8)
    columns = 6 if covars.shape[-1] == 6 else 9
    return Frame(
        poses=B,
        gaussians=N,
        channels=colors.shape[1],
        width=width,
        height=height,
        covar_columns=columns,
        covars_shared=covars.ndim < (3 if columns == 6 else 4),
        threads=threads,
        chunks=max(-(-N // 2**shift), 1),
        chunk_shift=shift,
        tiles_x=tiles_x,
        tiles_y=tiles_y,
        **options,
    )


def _project(
    native: Kernel, frame: Frame, inputs: Mapping[str, Tensor | None]
) -> dict[str, Tensor]:
    """Project all Gaussians and count the tiles they meet; returns what the kernel noted."""
    B, N = frame.poses, frame.gaussians
    tiles = frame.tiles_x * frame.tiles_y
    work = {
        "records": _bytes(64 * B * N),
        "placements": _bytes(16 * B * N),
        "radii": _int32(B, N),
        "histogram": _int32(B, frame.chunks, tiles),
        "tile_start": _int32(B, tiles + 1),
        "chunk_slot": _int32(B, frame.chunks + 1),
        "busy_index": _int32(B, tiles),
        "busy_start": _int32(B + 1),
    }
    frame.point(**inputs, **work)
    if problem := native.project(frame):
        if problem == _TOO_MANY_PAIRS:
            raise ValueError(f"{B} x {N} Gaussians meet too many tiles; render fewer at once")
        raise ValueError(next(not_finite(n) for bit, n in _NOT_FINITE.items() if problem & bit))
    return work


def _compositing_work(native: Kernel, frame: Frame, means: Tensor) -> dict[str, Tensor]:
    """Memory for sorting and compositing; what the backward pass reads only where it is kept."""
    work = {"sorted": _int32(frame.pairs)}
    if frame.keep:
        visits = frame.pairs // native.visits_group + frame.busy
        work |= {
            "busy_tiles": _int32(frame.busy),
            "composited": _int32(frame.busy),
            "visits": _bytes(native.visits_bytes * visits),
            "states": means.new_empty(
                native.states_floats[frame.channels + frame.depth] * frame.busy
            ),
        }
    return work


def _bytes(count: int) -> Tensor:
    return torch.empty(count, dtype=torch.uint8)


def _int32(*shape: int) -> Tensor:
    return torch.empty(shape, dtype=torch.int32)
