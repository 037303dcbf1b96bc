"""Ground truth that evaluation alone may see.

Dimensions. F frames, C cameras, R recorded cameras, V test views, J joints, B shape numbers,
P body vertices, T triangles, N Gaussians, S instants inside one exposure.
"""

from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float32, Int64, UInt8
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.storage import Artifact


@dataclass(frozen=True, kw_only=True)
class FilmedTruth(Artifact):
    """The truth of what was estimated from the training camera's blurred frames. Made by `clip`."""

    schema: ClassVar[str] = "filmed_truth/1"

    mattes: UInt8[Tensor, "F H W"]  # coverage of the person, the mean over each exposure
    focal: float  # pixels of the clip


@dataclass(frozen=True, kw_only=True)
class Reference(Artifact):
    """The sharp truth that only `evaluate` may see. Made by `clip`.

    View v shows frame `frame_indices[v]` of the clip from camera `camera_indices[v]`;
    `novel_pose[v]` is 1 for frames kept from training. `seen` is 255 where the surface point behind
    the pixel was seen by the training camera in some training frame. `motion` samples the true
    motion at `motion_times`, densely enough to cover every exposure. A user's own video has no
    truth: its reference has no views. Views may show other instants than the middle of the frame's
    exposure: `offsets` says which. `viewmats` are of footage whose world was estimated: where the
    test camera stood relative to the true motion, for evaluation to bring to the estimated one.
    """

    schema: ClassVar[str] = "reference/1"

    images: UInt8[Tensor, "V H W 3"]
    mattes: UInt8[Tensor, "V H W"]
    seen: UInt8[Tensor, "V H W"] | None
    camera_indices: Int64[Tensor, " V"]
    frame_indices: Int64[Tensor, " V"]
    novel_pose: Int64[Tensor, " V"]
    background: tuple[float, ...]  # sRGB in [0, 1] behind the person
    motion_times: Float32[Tensor, " M"] | None  # seconds
    motion: Poses | None  # at motion_times
    offsets: Float32[Tensor, " V"] | None = None  # seconds from that middle; None: none
    viewmats: Float32[Tensor, "V 4 4"] | None = None  # of each view; None: as the cameras say
    filmed: FilmedTruth | None = None
