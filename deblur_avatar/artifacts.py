"""What flows between stages; read top to bottom, this is the pipeline.

Dimensions. F frames, C cameras, R recorded cameras, V test views, J joints, B shape numbers,
P body vertices, T triangles, N Gaussians, S instants inside one exposure. Images are 8-bit sRGB;
mattes are 8-bit coverage, 255 for a pixel the person fills. Angles in radians, lengths in metres,
times in seconds. World axes are the source's own; cameras are OpenCV's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float32, Int64, UInt8
from torch import Tensor

from deblur_avatar.geometry.cameras import check_cameras
from deblur_avatar.storage import Artifact

SMPL_JOINT_NAMES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
SMPL_PARENTS = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Body(Artifact):
    """A person without clothes who can be shaped and posed. Made by `body`.

    Rest pose: SMPL's T-pose, +Y up, facing +Z, the left hand towards +X, joint frames aligned with
    the world. `pose_dirs` act on rotation matrices minus identity, joints 1 to J-1, row-major.
    """

    schema: ClassVar[str] = "body/1"

    vertices: Float32[Tensor, "P 3"]
    shape_dirs: Float32[Tensor, "P 3 B"]
    joints: Float32[Tensor, "J 3"]
    joint_dirs: Float32[Tensor, "J 3 B"]
    pose_dirs: Float32[Tensor, "P 3 D"] | None
    parents: tuple[int, ...]
    lbs_weights: Float32[Tensor, "P J"]
    faces: Int64[Tensor, "T 3"]
    uvs: Float32[Tensor, "T 3 2"] | None
    joint_names: tuple[str, ...]
    licence: str

    def validate(self) -> None:
        """Refuse trees that are not ordered, weights that do not sum to 1, faces out of range."""
        count = len(self.joints)
        if not count or not len(self.vertices):
            raise ValueError("a body has vertices and joints")
        if len(self.parents) != count or not all(-1 <= p < j for j, p in enumerate(self.parents)):
            raise ValueError(f"parents must name {count} joints, each after its parent")
        if (self.lbs_weights.sum(1) - 1).abs().max() > 1e-3 or self.lbs_weights.min() < 0:
            raise ValueError("lbs_weights must be non-negative with rows that sum to 1")
        if self.faces.numel() and not 0 <= self.faces.min() <= self.faces.max() < len(
            self.vertices
        ):
            raise ValueError("faces must index vertices")
        if self.pose_dirs is not None and self.pose_dirs.shape[2] != 9 * (count - 1):
            raise ValueError(f"pose_dirs must have {9 * (count - 1)} directions")


@dataclass(frozen=True, kw_only=True)
class Cameras(Artifact):
    """Where cameras stand and how they see; the true principal point is kept.

    `distortion` is OpenCV's (k1, k2, p1, p2, k3); all zero after `preprocess`.
    """

    schema: ClassVar[str] = "cameras/1"

    Ks: Float32[Tensor, "C 3 3"]  # pixels
    viewmats: Float32[Tensor, "C 4 4"]  # world to camera
    distortion: Float32[Tensor, "C 5"]
    sizes: Int64[Tensor, "C 2"]  # width, height in pixels
    names: tuple[str, ...]

    def validate(self) -> None:
        """Refuse cameras that cannot exist."""
        if len(self.names) != len(self.Ks):
            raise ValueError(f"{len(self.Ks)} cameras have {len(self.names)} names")
        check_cameras(self.Ks, self.viewmats)


@dataclass(frozen=True, kw_only=True)
class Poses(Artifact):
    """One body's shape, and its pose at F instants (SMPL's meaning, axis-angle)."""

    schema: ClassVar[str] = "poses/1"

    betas: Float32[Tensor, " B"]
    global_orient: Float32[Tensor, "F 3"]
    body_pose: Float32[Tensor, "F K 3"]  # K = J - 1
    transl: Float32[Tensor, "F 3"]

    def at(self, frames: slice | Sequence[int] | Tensor) -> "Poses":
        """Pick some of the instants."""
        index = frames if isinstance(frames, slice) else torch.as_tensor(frames, dtype=torch.long)
        return Poses(
            betas=self.betas,
            global_orient=self.global_orient[index],
            body_pose=self.body_pose[index],
            transl=self.transl[index],
        )


@dataclass(frozen=True, kw_only=True)
class Clip(Artifact):
    """Frames as the source recorded them. Made by `clip`.

    `frames[r]` comes from camera `recorded[r]`. A studio clip also carries what a real one cannot:
    mattes, poses, and the physically true blur of the training camera for the window asked for.
    `frame_indices` of the true blur are those frames whose window lies inside the clip. Landmarks
    are those that a user brought along.
    """

    schema: ClassVar[str] = "clip/1"

    frames: UInt8[Tensor, "R F H W 3"]
    mattes: UInt8[Tensor, "R F H W"] | None
    landmarks: Float32[Tensor, "R F L 3"] | None = None  # x, y (pixels), confidence; MediaPipe's 33
    recorded: tuple[int, ...]  # camera index of each stack of frames
    train_camera: int  # camera index
    cameras: Cameras
    timestamps: Float32[Tensor, " F"]  # seconds, the middle of each frame's exposure
    blurred: bool  # True if the frames are blurred already and `blur` must pass them through
    exposure: float | None  # seconds the shutter was open, where known
    light: str  # "srgb" or "linear": the space in which the camera averaged
    held_out_from: int  # frames from here on are kept from training (novel poses)
    initial: Poses | None  # poses given by the source, F of them
    exact: Poses | None  # true poses; for the method `ceiling` alone
    true_blur_srgb: UInt8[Tensor, "E H W 3"] | None
    true_blur_linear: UInt8[Tensor, "E H W 3"] | None
    true_blur_mattes: UInt8[Tensor, "E H W"] | None
    frame_indices: tuple[int, ...] | None  # E frame numbers of the true blur
    true_blur_exposure: float | None  # seconds its shutter was open: window / (factor * fps)

    def validate(self) -> None:
        """Refuse a training camera that was not recorded, times that do not increase."""
        _check_light(self.light)
        if self.train_camera not in self.recorded:
            raise ValueError(f"train_camera {self.train_camera} is not among {self.recorded}")
        if len(self.recorded) != len(self.frames):
            raise ValueError(f"{len(self.frames)} stacks of frames, {len(self.recorded)} cameras")
        if len(self.timestamps) > 1 and self.timestamps.diff().min() <= 0:
            raise ValueError("timestamps must increase")


@dataclass(frozen=True, kw_only=True)
class BlurryClip(Artifact):
    """Blurred frames of every recorded camera, the sharp ones at their middle, and the shutter.

    Made by `blur`. `frame_indices` say which frames of the clip they are; frames whose window
    leaves the clip are dropped. Mattes are averaged over the exposure as coverage, in either light.
    """

    schema: ClassVar[str] = "blurry_clip/1"

    frames: UInt8[Tensor, "R F H W 3"]
    mattes: UInt8[Tensor, "R F H W"] | None
    landmarks: Float32[Tensor, "R F L 3"] | None = None  # as in `Clip`
    sharp_frames: UInt8[Tensor, "F H W 3"] | None  # the training camera; for `oracle`, `ceiling`
    sharp_mattes: UInt8[Tensor, "F H W"] | None
    recorded: tuple[int, ...]
    train_camera: int
    cameras: Cameras
    frame_indices: tuple[int, ...]
    timestamps: Float32[Tensor, " F"]
    exposure: float | None
    light: str
    held_out_from: int  # position in this clip of the first frame kept from training
    initial: Poses | None
    exact: Poses | None

    def validate(self) -> None:
        """Refuse an unknown light and a clip without a training frame."""
        _check_light(self.light)
        if len(self.frame_indices) != len(self.timestamps):
            raise ValueError("frame_indices and timestamps must be of one length")
        if self.held_out_from < 1:
            raise ValueError("no frame is left for training; shorten the blur window")


@dataclass(frozen=True, kw_only=True)
class Observations(Artifact):
    """All that fitting sees: one camera's frames, soft mattes and poses. Made by `preprocess`.

    Frames are undistorted, cropped to the person and scaled: crop `crops[c]` (x, y, width, height
    in pixels of the clip) of camera c was scaled to `cameras.sizes[c]`. All frames of the clip are
    here, so that poses are known throughout; only `train` are fitted and `validation` are set
    aside.
    `weights` in [0, 1] say how far a frame's pose is to be trusted; 0 for frames without a person.
    `depth_known`: the poses tell how far joints are from the camera better than one camera can.
    `hidden` is the share of the body's surface that the training camera sees in no training frame.
    """

    schema: ClassVar[str] = "observations/2"

    frames: UInt8[Tensor, "F H W 3"]
    mattes: UInt8[Tensor, "F H W"]
    cameras: Cameras  # all cameras of the source, without distortion
    crops: Float32[Tensor, "C 4"]
    train_camera: int
    body: Body
    poses: Poses  # initial estimates, one a frame
    weights: Float32[Tensor, " F"]
    frame_indices: tuple[int, ...]
    timestamps: Float32[Tensor, " F"]
    exposure: float | None
    light: str
    train: tuple[int, ...]  # positions in this artifact
    validation: tuple[int, ...]
    depth_known: bool
    hidden: float

    def validate(self) -> None:
        """Refuse an unknown light, an empty training set, frames in two roles."""
        _check_light(self.light)
        if not self.train:
            raise ValueError("no training frame; check masks and the blur window")
        if set(self.train) & set(self.validation):
            raise ValueError("train and validation must not share frames")


@dataclass(frozen=True, kw_only=True)
class Reference(Artifact):
    """The sharp truth that only `evaluate` may see. Made by `clip`.

    View v shows frame `frame_indices[v]` of the clip from camera `camera_indices[v]`;
    `novel_pose[v]` is 1 for frames kept from training. `seen` is 255 where the surface point behind
    the pixel was seen by the training camera in some training frame. `motion` samples the true
    motion at `motion_times`, densely enough to cover every exposure. A user's own video has no
    truth: its reference has no views.
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


@dataclass(frozen=True, kw_only=True)
class Avatar(Artifact):
    """Canonical Gaussians and the networks that dress, skin and colour them.

    `model` is the composition (`config.ModelParams` as JSON) that tells how to read the rest.
    """

    schema: ClassVar[str] = "avatar/1"

    means: Float32[Tensor, "N 3"]  # canonical space
    quats: Float32[Tensor, "N 4"]  # wxyz, not normalised
    log_scales: Float32[Tensor, "N 3"]  # log metres
    opacity_logits: Float32[Tensor, " N"]
    features: Float32[Tensor, "N D"]  # appearance; its meaning is the model's
    betas: Float32[Tensor, " B"]
    networks: dict[str, Tensor]
    model: dict[str, Any]
    iteration: int


@dataclass(frozen=True, kw_only=True)
class Motion(Artifact):
    """How the body moved while the shutter was open, at instants `u` of every exposure.

    `centre` is the pose that a sharp picture of each frame is drawn with; `counts` are how many
    instants of each exposure fitting took. `parameters` hold the unknowns of the trajectory `kind`
    so that a later stage can go on.
    """

    schema: ClassVar[str] = "motion/2"

    kind: str
    u: Float32[Tensor, " S"]  # in [0, 1], 0 when the shutter opens
    timestamps: Float32[Tensor, " F"]
    counts: Int64[Tensor, " F"]
    shutter: float | None  # seconds it was open, where the motion estimated that
    global_orient: Float32[Tensor, "F S 3"]
    body_pose: Float32[Tensor, "F S K 3"]
    transl: Float32[Tensor, "F S 3"]
    centre: Poses
    parameters: dict[str, Tensor]


@dataclass(frozen=True, kw_only=True)
class Checkpoint(Artifact):
    """What an optimiser remembers, so that the next stage goes on where the last one stopped."""

    schema: ClassVar[str] = "checkpoint/1"

    iteration: int
    tensors: dict[str, Tensor]


def _check_light(light: str) -> None:
    if light not in ("srgb", "linear"):
        raise ValueError(f"light must be srgb or linear, got {light!r}")
