"""`params.yaml`, typed and strict.

Every default lives in `params.yaml`, none here. Unknown keys, missing keys, wrong types and values
out of range are errors that name the key. One class a section, in the order of the pipeline.
"""

import os
import re
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from ruamel.yaml import YAML
from ruamel.yaml.nodes import CollectionNode

from deblur_avatar.errors import ConfigError

P = TypeVar("P")

MOST_BYTES = 1 << 18  # of a parameter file; the root's has 10 kB, a megabyte takes ten seconds
MOST_NODES, MOST_DEPTH = 100_000, 50  # with every alias written out; the root's has 1,500, 8 deep
MOST_SHARED = 8  # files that name each other in turn

ENVIRONMENT = (
    r"\$\((?P<name>\w+)(?::-(?P<default>[^)]*))?\)",
    r"\$\{(?P<name>\w+)(?::-(?P<default>[^}]*))?\}",
)

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]


class Params(BaseModel):
    """A section: immutable, without defaults, closed to unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


# --- body ---------------------------------------------------------------------------------------


class AnnyBodyParams(Params):
    """The default body, free of licences that bind."""

    source: Literal["anny"]
    shape_components: Annotated[int, Field(ge=1, le=20)]


class SmplBodyParams(Params):
    """A licensed SMPL file; `file` may hold `$(VARIABLE)` from the environment."""

    source: Literal["smpl"]
    file: str
    shape_components: Annotated[int, Field(ge=1, le=300)]


BodyParams = Annotated[AnnyBodyParams | SmplBodyParams, Field(discriminator="source")]


# --- clip ---------------------------------------------------------------------------------------


class StudioParams(Params):
    """A synthetic person with exact truth.

    `motion` names a motion of `sources/studio`; `window` sub-frames (480 a second) are averaged
    into the true blur. Pose noise is correlated over `noise_correlation_s`.
    """

    source: Literal["studio"]
    motion: str
    frames: Annotated[int, Field(ge=2)]
    fps: Positive
    image_size: Annotated[int, Field(ge=8)]  # square, pixels
    test_cameras: Count
    test_stride: Count
    window: Count
    samples_per_axis: Count  # rays a pixel is (samples_per_axis)^2
    noise_degrees: NonNegative  # root mean square of each joint's angle of error
    noise_mm: NonNegative  # root mean square of the root's distance from its place
    noise_correlation_s: NonNegative
    held_out: Fraction  # last part of the clip, kept from training


class MultiviewParams(Params):
    """Video files of several calibrated cameras.

    `root` may hold `$(VARIABLE:-default)`. `frame_offsets` are added to each camera's frame
    numbers.
    """

    source: Literal["multiview"]
    root: str
    videos: tuple[str, ...]
    calibration: str
    frame_offsets: tuple[int, ...]
    principal_point_shifts: tuple[tuple[float, float], ...]  # added, pixels of the video
    frames: tuple[int, int]  # first, one past last
    image_height: Count  # frames are scaled to this height
    train_camera: Annotated[int, Field(ge=0)]
    test_stride: Count
    held_out: Fraction


class MonocularParams(Params):
    """One video of one person by one camera, blurred as it is; the camera may move.

    `path` is a video or a folder of pictures. It, `keypoints`, `masks` and `poses` may hold
    `$(VARIABLE:-default)`; null means that these are estimated from the frames.
    """

    source: Literal["monocular"]
    path: str
    frames: tuple[Annotated[int, Field(ge=0)], int | None]  # first, one past last; null: all
    stride: Count  # every so-manieth of them is taken
    fps: Positive  # of a folder of pictures; a video brings its own times
    image_height: Count  # frames are scaled down to this height
    focal: Literal["estimated", "field_of_view"] | Positive  # pixels of the footage as recorded
    field_of_view: Annotated[float, Field(gt=5, lt=150)]  # degrees, longer side; the last resort
    exposure_s: Positive | None  # seconds the shutter is open; null: `shutter` says
    shutter: Annotated[float, Field(gt=0, le=1)]  # exposure as a share of the frame interval
    light: Literal["srgb", "linear"]
    held_out: Annotated[float, Field(ge=0, lt=1)]  # last part of the clip, kept from training
    keypoints: str | None  # OpenPose's or COCO's JSON
    masks: str | None  # folder of pictures; not black is person
    poses: str | None  # .npz


class ZjuMocapParams(Params):
    """A sequence in ZJU-MoCap's raw layout (docs/zju-mocap.md).

    `root` may hold `$(VARIABLE:-default)`. Cameras are counted from 0 in the order of `annots.npy`,
    frames as it lists them.
    """

    source: Literal["zju_mocap"]
    root: str
    frames: tuple[Annotated[int, Field(ge=0)], int | None]  # first, one past last (null: all)
    stride: Count  # every so-manieth of them is a frame of the clip
    fps: Positive  # of the recording
    image_height: Count  # pictures that are taller are scaled down to this
    train_camera: Annotated[int, Field(ge=0)]
    test_cameras: tuple[Annotated[int, Field(ge=0)], ...] | Literal["all"]  # all others
    test_stride: Count  # frames of the clip between two test views
    pose_cameras: tuple[Annotated[int, Field(ge=0)], ...]  # recorded too, for estimated poses
    mask_folders: Annotated[tuple[Literal["mask", "mask_cihp"], ...], Field(min_length=1)]
    mask_dilation: Annotated[int, Field(ge=0)]  # pixels of the pictures as filmed
    background: Literal["black", "filmed"]  # of the clip; black is what masks leave out
    poses: Literal["new_params", "none"]
    held_out: Fraction  # last part of the clip, kept from training


ClipParams = Annotated[
    StudioParams | MultiviewParams | MonocularParams | ZjuMocapParams,
    Field(discriminator="source"),
]


# --- blur ---------------------------------------------------------------------------------------


class BlurParams(Params):
    """Windows of interpolated sub-frames, as in the paper."""

    frames: Literal["interpolated", "true"]
    factor: Count  # sub-frames a frame
    window: Count  # sub-frames averaged, odd
    light: Literal["srgb", "linear"]


# --- preprocess ---------------------------------------------------------------------------------


class PreprocessParams(Params):
    """Masks, crops and poses from blurred frames."""

    poses: Literal["given", "estimated"]
    masks: Literal["given", "estimated"]
    background: Literal["none", "median", "auto"]  # taken away behind a soft matte; auto: median
    # where the camera stands still
    depth: Literal[
        "known", "unknown"
    ]  # known: the poses come from several views, say, and tell how
    # far joints are from the camera better than the training camera can
    margin: NonNegative  # of the crop, as a share of the person's box
    validation_stride: Annotated[int, Field(ge=2)]  # every so-manieth frame is set aside


# --- predeblur ----------------------------------------------------------------------------------


class PredeblurParams(Params):
    """Deblurring in the picture, for a baseline (imaging/deconvolution.py).

    `given` is a folder of frames that another program has deblurred, and may hold
    `$(VARIABLE:-default)`; empty for the classical method, which the rest is for.
    """

    given: str
    lengths: Annotated[tuple[Positive, ...], Field(min_length=1)]  # of streaks tried, pixels
    angles: Count  # directions tried
    balance: Positive  # smoothness against closeness
    surroundings: Positive  # pixels, of the window in which the matte is judged
    gain: Fraction  # by which the matte must become clearer


# --- check --------------------------------------------------------------------------------------


class CheckParams(Params):
    """What happens to a scene that fails its check."""

    on_failure: Literal["warn", "stop"]


# --- avatar and its fitting ---------------------------------------------------------------------


class ScheduleParams(Params):
    """How much work a run is: when each stage ends, how large avatar and pictures are."""

    warmup: Count  # iterations
    trajectory: Count
    fusion: Count
    gaussians: Count
    image_height: Annotated[int, Field(ge=8)]  # pixels

    def halvings(self, count: int) -> frozenset[int]:
        """Iterations at 1/2, 1/4, 1/8 ... of a run, and at its stages' ends; none for a count of 0.

        Raises:
            ConfigError: if the count is negative.
        """
        if count < 0:
            raise ConfigError(f"snapshots: wanted 0 or more, got {count}")
        halves = (round(self.fusion / 2**power) for power in range(1, count + 1))
        ends = (self.warmup, self.trajectory, self.fusion) if count else ()
        return frozenset(halves) | frozenset(ends)

    @model_validator(mode="after")
    def _in_order(self) -> "ScheduleParams":
        if not self.warmup < self.trajectory < self.fusion:
            raise ValueError("warmup < trajectory < fusion must hold")
        return self


class NonRigidParams(Params):
    """The network that moves clothes with the pose."""

    bins: Count  # of the one-blob encoding, per axis
    hidden: tuple[Count, ...]
    codes: Annotated[int, Field(ge=0)]  # numbers handed on to the colours


class SkinningParams(Params):
    """The network that learns blend weights; None means the body's own."""

    hidden: tuple[Count, ...]
    pretrain: Annotated[int, Field(ge=0)]  # iterations on the body's own weights before anything


class ColorParams(Params):
    """The network that colours; None means one colour a Gaussian."""

    features: Count
    hidden: tuple[Count, ...]
    latent: Count
    view_noise_degrees: NonNegative


class ModelParams(Params):
    """Which parts an avatar is composed of."""

    nonrigid: NonRigidParams | None
    skinning: SkinningParams | None
    color: ColorParams | None


class LossParams(Params):
    """Weights of the terms of the objective."""

    l1: NonNegative
    lpips: NonNegative  # inside the person's box, in place of `structure`; only with its weights
    structure: NonNegative  # edges at three scales inside the person's box
    dissimilarity: NonNegative  # 1 - SSIM at three scales there
    mask: NonNegative
    skinning_early: NonNegative  # until `skinning_switch`
    skinning_late: NonNegative
    isotropy_means: NonNegative  # neighbours keep their distances
    isotropy_covars: NonNegative
    even_colors: (
        NonNegative  # of a body of which nothing is seen: neighbours' raw colours are alike
    )
    even_shapes: NonNegative  # their raw scales and opacities
    even_heights: NonNegative  # and how far they stand off the body
    anchor: NonNegative  # clip motion: knots stay near the first estimate
    depth: NonNegative  # clip motion: so do joints' distances from the camera, where depth is known
    shutter: NonNegative  # clip motion: an estimated shutter stays near the first guess


class DensifyParams(Params):
    """Where Gaussians are added and taken away."""

    start: Count
    stop: Count
    every: Count
    gradient: Positive  # of the screen position, in half image widths
    clone_below_m: Positive
    prune_opacity: Fraction
    prune_scale_m: Positive
    most: Positive  # times the first count


class OptimiserParams(Params):
    """Learning rates, and when what starts. Iterations count as in the paper's 15,000."""

    means: Positive
    means_final: Positive
    features: Positive
    opacities: Positive
    scales: Positive
    quats: Positive
    rigid: Positive
    nonrigid: Positive
    color: Positive
    latent_decay: NonNegative
    poses: Positive  # radians a step
    transl: Positive  # metres a step
    shutter: Positive  # share of itself a step, where it is estimated
    fusion: Positive
    final_share: Fraction  # of the networks' rates at the end
    clip: Positive  # norm of all networks' gradients
    gaussians_start: Annotated[int, Field(ge=0)]
    nonrigid_start: Annotated[int, Field(ge=0)]
    skinning_switch: Annotated[int, Field(ge=0)]
    pose_noise: NonNegative  # of the conditioning rotations, in half of the steps


class StartParams(Params):
    """What an avatar is made of and how it is fitted; methods that agree on it share a warm-up."""

    model: ModelParams
    optimiser: OptimiserParams
    losses: LossParams
    densify: DensifyParams
    exposure_gain: Literal["none", "frame"]  # frame: each may be brighter than the clip, or darker


class TrajectoryParams(Params):
    """How the body moves while the shutter is open, and what the frame is compared with."""

    motion: Literal["fixed", "frame", "pair", "cubic", "learned", "released", "clip"]
    virtual_poses: Count  # at most, where `pixels_per_pose` says how many
    pixels_per_pose: (
        NonNegative  # clip: farthest travel in the picture per virtual pose; 0: always all
    )
    shutter: Literal["given", "estimated"]  # clip: how long it was open
    quadrature: Literal["endpoints", "midpoints"]
    start_noise: NonNegative  # pair: radians; parts start from end
    knot_frames: Positive  # clip: frames between two knots of the trajectory, at most
    finest_knot_frames: Positive  # clip: and at least, where given poses ask for finer knots
    smoothness: NonNegative  # clip: of the first trajectory, against closeness to the given poses
    supervision: Literal["sharp", "mean", "released"]
    mask: Literal["mean", "union", "centre"]


class FusionNetworkParams(Params):
    """The paper's per-pixel blend of the sharp and the averaged render."""

    hidden: tuple[Count, ...]
    frame_codes: Count
    color_features: Count
    pose: bool  # whether it sees the pose's code (of avatars that have one)


class FusionParams(Params):
    """The last stage: what the frame is compared with from here on."""

    supervision: Literal["sharp", "mean", "fused", "released"]
    mask: Literal["mean", "union", "centre"]
    network: FusionNetworkParams | None


class MethodParams(Params):
    """A row of every table."""

    trajectory: TrajectoryParams
    fusion: FusionParams


class SceneParams(Params):
    """Footage, from its files to what fitting sees."""

    body: str
    clip: ClipParams
    blur: BlurParams
    preprocess: PreprocessParams


class WarmupParams(Params):
    """A start on one scene's frames."""

    scene: str
    observations: Literal["exact", "sharp", "blurred", "deblurred"]
    start: str


class RunParams(Params):
    """One method on one scene: which frames it sees and which warm-up it goes on from."""

    scene: str
    observations: Literal["exact", "sharp", "blurred", "deblurred"]
    start: str
    method: str


# --- animate ------------------------------------------------------------------------------------


class AnimationParams(Params):
    """A motion that the avatar of the run of this name is shown in.

    `motion` is `own` (the one that was filmed), `builtin:<name>` or a file, and may hold
    `$(VARIABLE:-default)`.
    """

    scene: str
    motion: str
    start: NonNegative  # seconds into the motion
    seconds: Positive
    fps: Positive
    image_size: Annotated[int, Field(ge=16, multiple_of=2)]  # square, pixels; videos want it even
    turns: float  # of the stage from the first frame to the last, so that every side is seen
    travel: Fraction  # of the motion's steps; 0 is on the spot
    margin: NonNegative  # around the person, as a share of the picture she fills


# --- the loader ---------------------------------------------------------------------------------


def load_params(path: Path, key: str, kind: Any) -> Any:
    """Read one section (`"methods.paper.fusion"`) of a parameter file.

    Raises:
        ConfigError: naming the file, the key, what was wanted and what came.
    """
    return section_of(read_params(path), path, key, kind)


def read_params(path: Path) -> Any:
    """Read a parameter file; sections that it lacks come from the file that its `shared` names.

    That file may name another in turn.

    Raises:
        ConfigError: if one of the two is missing or is not YAML, or they name each other.
    """
    return _with_shared(Path(path), 0)


def _with_shared(path: Path, above: int) -> Any:
    if above > MOST_SHARED:
        raise ConfigError(
            f"{path}: shared leads through over {MOST_SHARED} files; does one lead back to another?"
        )
    content = read_yaml(path)
    if not isinstance(content, dict) or "shared" not in content:
        return content
    other = path.parent / parse(str, content["shared"], f"{path}: shared")
    below = _with_shared(other, above + 1)
    if not isinstance(below, dict):
        raise ConfigError(f"{path}: shared: {other} must hold sections, got {below!r:.60}")
    return {**below, **{key: value for key, value in content.items() if key != "shared"}}


def section_of(content: Any, path: Path, key: str, kind: Any) -> Any:
    """Check one section of what a parameter file holds; `path` is named in what is refused.

    Raises:
        ConfigError: naming the key, what was wanted and what came.
    """
    value = content
    for depth, name in enumerate(key.split(".")):
        if not isinstance(value, dict) or name not in value:
            above = ".".join(key.split(".")[:depth]) or "the file"
            known = ", ".join(map(str, value)) if isinstance(value, dict) else "no keys"
            raise ConfigError(f"{path}: {key}: {above} has no key {name!r}, it has {known}")
        value = value[name]
    return parse(kind, value, f"{path}: {key}")


def check_parameters(path: Path) -> None:
    """Check a whole parameter file before any work: every section, and every name in it.

    Raises:
        ConfigError: for the first section that cannot be run.
    """
    content = read_params(path)
    sections: dict[str, Any] = {
        "schedules": ScheduleParams,
        "bodies": BodyParams,
        "starts": StartParams,
        "methods": MethodParams,
        "scenes": SceneParams,
        "predeblur": PredeblurParams,
        "warmups": WarmupParams,
        "runs": RunParams,
        "animations": AnimationParams,
    }
    section_of(content, path, "seed", int)
    section_of(content, path, "snapshots", int)
    section_of(content, path, "check", CheckParams)
    for section, kind in sections.items():
        for name in section_of(content, path, section, dict):
            section_of(content, path, f"{section}.{name}", kind)
    section_of(content, path, f"schedules.{section_of(content, path, 'schedule', str)}", dict)
    for name in content["predeblur"].keys() - content["scenes"].keys():
        raise ConfigError(f"{path}: predeblur.{name}: there is no scene {name!r}")
    named = {"scene": "scenes", "start": "starts", "method": "methods"}
    for section in ("warmups", "runs"):
        for name, entry in content[section].items():
            for key in named.keys() & entry.keys():
                if entry[key] not in content[named[key]]:
                    known = ", ".join(content[named[key]])
                    raise ConfigError(
                        f"{path}: {section}.{name}: no {key} {entry[key]!r}, there is {known}"
                    )
    for name, entry in content["runs"].items():
        warmup = f"{entry['scene']}-{entry['observations']}-{entry['start']}"
        if warmup not in content["warmups"]:
            raise ConfigError(f"{path}: runs.{name} goes on from {warmup}, add it to warmups")
    for name, entry in content["animations"].items():
        if content["runs"].get(name, {}).get("scene") != entry["scene"]:
            raise ConfigError(f"{path}: animations.{name}: no run {name!r} on {entry['scene']!r}")


def parse(kind: Any, value: Any, where: str) -> Any:
    """Check one section against its class.

    Raises:
        ConfigError: all complaints at once, each with its key.
    """
    try:
        return TypeAdapter(kind).validate_python(_tuples(value))
    except ValidationError as error:
        complaints = [_complaint(item) for item in error.errors()]
        raise ConfigError(f"{where}: " + "; ".join(complaints)) from None


def expand_environment(text: str, where: str) -> str:
    """Replace `$(VARIABLE)` and `$(VARIABLE:-default)` by what the environment holds.

    Braces do as well, but `dvc exp run -S` refuses files that hold them: it reads them as its own.
    An empty variable counts as unset, as in a shell.

    Raises:
        ConfigError: naming `where`, for a variable that is not set and has no default.
    """

    def value(match: re.Match[str]) -> str:
        found = os.environ.get(match["name"]) or match["default"]
        if found is None:
            raise ConfigError(f"{where}: set the environment variable {match['name']}, it is empty")
        return found

    for pattern in ENVIRONMENT:
        text = re.sub(pattern, value, text)
    return text


def read_yaml(path: Path) -> Any:
    """Read a YAML 1.2 file as DVC does (`1e-3` is a number, `no` is a word).

    Raises:
        ConfigError: if it is missing, is not YAML, or is or unfolds to far more than parameters.
    """
    try:
        with Path(path).open("rb") as file:
            text = file.read(MOST_BYTES + 1)
        if len(text) > MOST_BYTES:
            raise ConfigError(f"{path} has over {MOST_BYTES >> 10} kB; is it a parameter file?")
        return deepcopy(_yaml(text))
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    except Exception as error:
        # Damaged YAML raises nearly anything from inside ruamel.yaml: a date without a month, say.
        raise ConfigError(f"{path} is not YAML: {error or repr(error)}") from None


@lru_cache(maxsize=8)  # a stage reads its parameters section by section
def _yaml(text: bytes) -> Any:
    """What YAML text holds, once its nodes show that it does not unfold to any size."""
    yaml = YAML(typ="safe", pure=True)
    node = yaml.compose(text)
    _unfolded(node, {}, 0)
    return None if node is None else yaml.constructor.construct_document(node)


def _unfolded(node: Any, known: dict[int, int | None], depth: int) -> int:
    """How many nodes one stands for with every alias below it written out."""
    if id(node) in known:
        count = known[id(node)]
        if count is None:
            raise ValueError(f"the alias of line {node.start_mark.line + 1} contains itself")
        return count
    if depth > MOST_DEPTH:
        raise ValueError(f"line {node.start_mark.line + 1} is nested over {MOST_DEPTH} levels deep")
    known[id(node)] = None
    content = node.value if isinstance(node, CollectionNode) else ()
    below = [part for item in content for part in (item if isinstance(item, tuple) else (item,))]
    count = 1 + sum(_unfolded(part, known, depth + 1) for part in below)
    if count > MOST_NODES:
        raise ValueError(f"its aliases stand for over {MOST_NODES} values")
    known[id(node)] = count
    return count


def _tuples(value: Any) -> Any:
    """Lists become tuples, so that parsed sections are immutable all the way down."""
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    return value


def _complaint(item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"]) or "value"
    if item["type"] == "extra_forbidden":
        return f"unknown key {key!r}"
    if item["type"] == "missing":
        return f"missing key {key!r}"
    return f"{key}: {item['msg'][0].lower() + item['msg'][1:]}, got {item['input']!r:.200}"
