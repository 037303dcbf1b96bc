"""Every reader of files that this project has, each with a small file that it reads.

A reader that is missing here is found by `test_readers.py` beside it.
"""

import contextlib
import dataclasses
import json
import pickle
import struct
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from PIL import Image
from scipy import sparse

from deblur_avatar.animation.motion_files import read_motion
from deblur_avatar.artifacts import (
    avatar,
    body,
    cameras,
    checkpoint,
    clip,
    deblurring_clips,
    motion,
    observations,
    poses,
    reference,
)
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import SMPL_PARENTS, Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.storage import Artifact
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.bodies.smpl import read_smpl
from deblur_avatar.cli import avatar_params, homes
from deblur_avatar.config.reading import read_yaml
from deblur_avatar.config.runs import RunParams
from deblur_avatar.evaluation.costs import (
    STAGES,
    cost_files,
    read_costs,
    with_seconds,
)
from deblur_avatar.files import read_json, write_json
from deblur_avatar.imaging import dstnet_weights
from deblur_avatar.imaging.dstnet import Dstnet, DstnetParams
from deblur_avatar.imaging.picture_files import read_mask, read_picture, write_light
from deblur_avatar.parameters import check_parameters
from deblur_avatar.pipeline.report import read_results
from deblur_avatar.reporting.picture_strips import strips_of_scene
from deblur_avatar.sources.calibration import read_calibration
from deblur_avatar.sources.focal_length import focal_of_files
from deblur_avatar.sources.footage import read_footage
from deblur_avatar.sources.given_masks import read_masks
from deblur_avatar.sources.given_poses import read_poses
from deblur_avatar.sources.keypoint_files import follow_person, read_keypoints
from deblur_avatar.sources.zju_mocap import poses as zju_poses
from deblur_avatar.sources.zju_mocap.annotations import read_annotations
from deblur_avatar.sources.zju_mocap.pictures import (
    mask_folders_here,
    picture_size,
    read_person,
)
from deblur_avatar.training import resume as run_folder
from tests.sources.small_videos import picture, write_video

ROOT = Path(__file__).parents[2]
BODY = capsule_body()
FRAMES = 3
TINY = DstnetParams(features=1, blocks=1, refinements=1)


@dataclasses.dataclass(frozen=True)
class Reader:
    """One way in: `write` puts files into an empty folder, `read` reads that folder."""

    name: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]


# --- parameters and numbers ---------------------------------------------------------------------


def _write_parameters(folder: Path) -> None:
    """The smallest part of the root's file that hangs together, in two files."""
    content = read_yaml(ROOT / "params.yaml")
    name, wanted = next(iter(content["runs"].items()))
    warmup = f"{wanted['scene']}-{wanted['observations']}-{wanted['avatar']}"
    used = {
        "schedules": content["schedule"], "bodies": "anny", "scenes": wanted["scene"],
        "avatars": wanted["avatar"], "methods": wanted["method"], "warmups": warmup, "runs": name,
    }  # fmt: skip
    below = {section: {key: content[section][key]} for section, key in used.items()}
    below |= {"check": content["check"], "animations": {}, "exports": {}, "predeblur": {}}
    below |= {
        "from": content["from"],
        "checks": [],
        "learning_curves": {},
        "self_checks": {},
        "reports": [],
        "without_pictures": [],
    }
    above = {"shared": "below.yaml", "seed": 0, "snapshots": 0, "schedule": content["schedule"]}
    (folder / "below.yaml").write_text(json.dumps(below, indent=1))
    (folder / "params.yaml").write_text(json.dumps(above, indent=1))


def _write_avatar(folder: Path) -> None:
    """What `make avatar` wrote for one video."""
    avatars = {"lean": {"model": {"kind": "plain"}}}
    shared = {
        "methods": {"lean": {}},
        "observations": {},
        "avatars": avatars,
        "schedules": {"medium": {}},
    }
    shared |= {"snapshots": 0}
    clip = {"path": str((folder / "film.mp4").resolve())}
    own = {
        "scenes": {"me": {"clip": clip}},
        "warmups": {},
        "runs": {},
        "animations": {},
        "exports": {},
    }
    own |= {"bodies": {}}
    (folder / "params.yaml").write_text(json.dumps(shared))
    (folder / "dvc.yaml").write_text("stages: {}\n")  # so that it is a checkout
    (folder / "stages").mkdir()
    place = folder / homes.AVATARS / "me" / "params.yaml"
    place.parent.mkdir(parents=True)
    place.write_text(json.dumps({"shared": "../../params.yaml"} | own))


class _Read(Exception):
    """All has been read, and what follows would write."""


def _avatar(folder: Path) -> None:
    installed = mock.patch.object(homes.Home, "install", side_effect=_Read)
    with installed, contextlib.suppress(_Read):
        avatar_params.prepare(folder / "film.mp4", "me", "lean", "medium", folder)


def _write_numbers(folder: Path) -> None:
    cost = {"seconds": 1.5, "peak_memory_mb": 300.0}
    write_json(folder / "fit.json", {"track": {"mean": 0.5}, "frames": [1, 2]} | cost)


_RUN = RunParams(scene="s", observations="blurred", avatar="t", method="m")


def _write_metrics(folder: Path) -> None:
    content = {"scene": "s", "method": "m", "views": {"psnr_db": 20.5}}
    write_json(folder / "s" / "m.json", content)


def _write_costs(folder: Path) -> None:
    cost = {"seconds": 1.5, "peak_memory_mb": 300.0}
    for stage in STAGES:
        write_json(cost_files(folder, _RUN)[stage], cost)


def _write_moments(folder: Path) -> None:
    cost = {"seconds": 1.5, "snapshots": [{"iteration": 3, "seconds": 0.5}]}
    for stage in STAGES:
        write_json(cost_files(folder, _RUN)[stage], cost)


def _moments(folder: Path) -> object:
    points = [{"stage": stage, "iteration": 3} for stage in STAGES]
    return with_seconds({"points": points}, cost_files(folder, _RUN))


def _write_snapshots(folder: Path) -> None:
    """What a run that was stopped has kept, less what is no number."""
    for iteration in (3, 6):
        (folder / f"snapshots/{iteration:06d}").mkdir(parents=True)
        write_json(folder / f"snapshot_{iteration:06d}.json", {"seconds": 0.5})


def _write_views(folder: Path) -> None:
    for name in ("render.png", "truth.png", "input.png"):
        Image.fromarray(picture(3)).save(folder / name)
    view = {
        "camera": "a", "frame": 3, "novel_pose": True, "render": "render.png", "truth": "truth.png",
        "blurred": "input.png",
    }  # fmt: skip
    write_json(folder / "views.json", [view, view | {"frame": 4}])


# --- artifacts ----------------------------------------------------------------------------------


def _cameras() -> Cameras:
    return Cameras(
        Ks=torch.tensor([[[40.0, 0, 4], [0, 40.0, 3], [0, 0, 1]]]),
        viewmats=torch.eye(4)[None],
        distortion=torch.zeros(1, 5),
        sizes=torch.tensor([[8, 6]]),
        names=("front",),
    )


def _poses(frames: int = FRAMES) -> Poses:
    return Poses(
        betas=torch.zeros(1),
        global_orient=torch.zeros(frames, 3),
        body_pose=torch.zeros(frames, 1, 3),
        transl=torch.ones(frames, 3),
    )


def _body() -> Body:
    return Body(
        vertices=torch.eye(3),
        shape_dirs=torch.ones(3, 3, 1),
        joints=torch.zeros(2, 3),
        joint_dirs=torch.zeros(2, 3, 1),
        pose_dirs=torch.zeros(3, 3, 9),
        parents=(-1, 0),
        lbs_weights=torch.full((3, 2), 0.5),
        faces=torch.tensor([[0, 1, 2]]),
        uvs=torch.zeros(1, 3, 2),
        joint_names=("root", "end"),
        licence="free",
    )


def _images(*shape: int) -> torch.Tensor:
    return torch.arange(int(np.prod(shape))).reshape(shape).to(torch.uint8)


def _times(count: int = FRAMES) -> torch.Tensor:
    return torch.arange(count) / 30


def example(kind: type[Artifact]) -> Artifact:
    """A small artifact of each kind, with every field that may be there."""
    frames, stack = tuple(range(FRAMES)), (1, FRAMES, 6, 8)
    clip = {
        "frames": _images(*stack, 3), "mattes": _images(*stack),
        "landmarks": torch.ones(1, 3, 4, 3),
        "recorded": (0,), "train_camera": 0, "cameras": _cameras(), "timestamps": _times(),
        "exposure": 0.01, "averaging_space": "srgb", "held_out_from": 2, "initial": _poses(),
        "exact": _poses(), "frame_indices": frames,
    }  # fmt: skip
    fields: dict[str, dict[str, object]] = {
        "Body": vars(_body()),
        "Cameras": vars(_cameras()),
        "Poses": vars(_poses()),
        "Clip": clip | {
            "blurred": True, "true_blur_srgb": _images(3, 6, 8, 3),
            "true_blur_linear": _images(3, 6, 8, 3), "true_blur_mattes": _images(3, 6, 8),
            "true_blur_exposure": 0.01,
        },
        "BlurryClip": clip | {
            "sharp_frames": _images(3, 6, 8, 3), "sharp_mattes": _images(3, 6, 8),
        },
        "Observations": {
            "frames": _images(3, 6, 8, 3), "mattes": _images(3, 6, 8),
            "comparable": _images(3, 6, 8), "backgrounds": _images(1, 6, 8, 3),
            "cameras": _cameras(),
            "crops": torch.ones(1, 4), "train_camera": 0, "body": _body(), "poses": _poses(),
            "weights": torch.ones(3), "frame_indices": frames, "timestamps": _times(),
            "exposure": 0.01, "averaging_space": "srgb", "train": (0, 1), "validation": (2,),
            "depth_known": True, "pose_std": 0.03, "occluded_fraction": 0.5,
        },
        "Reference": {
            "images": _images(2, 6, 8, 3), "mattes": _images(2, 6, 8), "seen": _images(2, 6, 8),
            "camera_indices": torch.zeros(2, dtype=torch.long), "novel_pose": torch.tensor([0, 1]),
            "frame_indices": torch.tensor([0, 1]), "background": (0.0, 0.0, 0.0),
            "motion_times": _times(2), "motion": _poses(2), "offsets": torch.zeros(2),
            "viewmats": torch.eye(4).repeat(2, 1, 1),
            "filmed": reference.FilmedTruth(mattes=_images(3, 4, 8), focal=40.0),
        },
        "FilmedTruth": {"mattes": _images(3, 4, 8), "focal": 40.0},
        "Avatar": {
            "means": torch.ones(4, 3), "quats": torch.ones(4, 4), "log_scales": torch.ones(4, 3),
            "opacity_logits": torch.ones(4), "features": torch.ones(4, 2), "betas": torch.ones(1),
            "networks": {"a": torch.ones(2), "b.c": torch.ones(1)}, "iteration": 3,
            "model": {"nonrigid": None, "skinning": None, "color": None},
        },
        "Motion": {
            "kind": "clip", "u": torch.tensor([0.0, 1.0]), "timestamps": _times(),
            "num_samples": torch.tensor([2, 2, 2]), "shutter": 0.01,
            "global_orient": torch.zeros(3, 2, 3), "body_pose": torch.zeros(3, 2, 1, 3),
            "transl": torch.zeros(3, 2, 3), "centre": _poses(), "parameters": {"a": torch.ones(2)},
        },
        "Progress": {
            "key": "x", "iteration": 3, "seconds": 0.5, "left_out": 0,
            "tensors": {"a": torch.ones(2)},
        },
        "DeblurringClips": {
            "sharp": _images(1, 3, 6, 8, 3), "sharp_mattes": _images(1, 3, 6, 8),
            "blurred": _images(1, 2, 3, 6, 8, 3), "blurred_mattes": _images(1, 2, 3, 6, 8),
            "windows": (17, 33), "averaging_spaces": ("linear",),
        },
        "DstnetWeights": {
            **TINY.model_dump(), "recipe": "{}", "clips": "", "tensors": Dstnet(TINY).state_dict(),
        },
        "Checkpoint": {"iteration": 3, "tensors": {"a": torch.ones(2), "b": torch.arange(2)}},
    }  # fmt: skip
    if kind is run_folder.Snapshot:
        return kind(avatar=example(Avatar), motion=example(Motion))
    return kind(**fields[kind.__name__])


ARTIFACTS = tuple(
    kind
    for module in (
        avatar,
        body,
        cameras,
        checkpoint,
        clip,
        deblurring_clips,
        dstnet_weights,
        motion,
        observations,
        poses,
        reference,
        run_folder,
    )
    for kind in vars(module).values()
    if isinstance(kind, type)
    and issubclass(kind, Artifact)
    and kind is not Artifact
    and kind.__module__ == module.__name__
)

# --- calibration --------------------------------------------------------------------------------

_QUALISYS = """<?xml version="1.0"?><calibration created="x"><cameras>
<camera active="1" serial="{serial}" viewrotation="0">
<fov_video left="0" top="0" right="1087" bottom="1919"/>
<transform x="2000.0" y="-100.0" z="1200.0" r11="1" r12="0" r13="0" r21="0" r22="1" r23="0"
 r31="0" r32="0" r33="1"/>
<intrinsic focalLengthU="89600" focalLengthV="89600" centerPointU="34700" centerPointV="61000"
 skew="0" radialDistortion1="-0.04" radialDistortion2="0.01" radialDistortion3="0"
 tangentalDistortion1="0.001" tangentalDistortion2="-0.001"/></camera>"""


def _write_qualisys(folder: Path) -> None:
    one, two = (_QUALISYS.format(serial=serial) for serial in "12")
    text = one + two.split("<cameras>")[1] + "</cameras></calibration>"
    (folder / "a.qca.txt").write_text(text)


def _write_pose2sim(folder: Path) -> None:
    table = """[cam_{0}]
name = "cam{0}"
size = [ 1088.0, 1920.0]
matrix = [ [ 1400.0, 0.0, 542.0], [ 0.0, 1400.0, 953.0], [ 0.0, 0.0, 1.0]]
distortions = [ -0.05, 0.01, 0.001, -0.001]
rotation = [ 1.2, -0.7, 0.4]
translation = [ 0.5, 1.1, 4.2]
fisheye = false

"""
    end = "[metadata]\nadjusted = false\nerror = 0.0\n"
    (folder / "a.toml").write_text(table.format(1) + table.format(2) + end)


def _write_colmap(folder: Path) -> None:
    """Two cameras as COLMAP writes them: a lens with one coefficient, no points."""
    lenses, views = struct.pack("<Q", 2), struct.pack("<Q", 2)
    for key in (1, 2):
        lenses += struct.pack("<iiQQ4d", key, 2, 640, 480, 500.0, 320.0, 240.0, -0.05)
        views += struct.pack("<I7dI", key, 0.6, 0.0, 0.8, 0.0, 0.5, 1.0, 4.0, key)
        views += b"cam%d.png\0" % key + struct.pack("<Q", 1) + struct.pack("<ddq", 1.0, 2.0, -1)
    (folder / "cameras.bin").write_bytes(lenses)
    (folder / "images.bin").write_bytes(views)


def _write_colmap_text(folder: Path) -> None:
    lens = "SIMPLE_RADIAL 640 480 500.0 320.0 240.0 -0.05"
    (folder / "cameras.txt").write_text(f"# lenses\n1 {lens}\n2 {lens}\n")
    view = "0.6 0.0 0.8 0.0 0.5 1.0 4.0"
    (folder / "images.txt").write_text(f"1 {view} 1 a.png\n1.0 2.0 -1\n2 {view} 2 b.png\n\n")


# --- motions ------------------------------------------------------------------------------------

_BVH = """HIERARCHY
ROOT Reference
{
\tOFFSET 0.0 0.0 0.0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
\tJOINT Hips
\t{
\tOFFSET 0.0 90.0 0.0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
"""


def _write_bvh(folder: Path) -> None:
    """A skeleton with the joints that a body of ours is driven by, its way below the root."""
    text = _BVH + _joint("Spine", 0, 15)
    for chain, (x, y) in (
        (("Neck", "Head"), (0, 15)), (("LeftArm", "LeftForeArm", "LeftHand"), (15, 5)),
        (("RightArm", "RightForeArm", "RightHand"), (-15, 5)), ((), (0, 0)),
        (("LeftUpLeg", "LeftLeg", "LeftFoot"), (8, -40)),
        (("RightUpLeg", "RightLeg", "RightFoot"), (-8, -40)),
    ):  # fmt: skip
        text += "".join(_joint(name, x, y) for name in chain)
        text += f"End Site\n{{\nOFFSET {x} {y} 0\n}}\n" if chain else ""
        text += "}\n" * (len(chain) or 1)  # what is empty closes the spine
    row = " ".join(["0.5"] * 57)
    text += "}\n}\nMOTION\nFrames: 3\nFrame Time: 0.0333\n" + f"{row}\n" * 3
    (folder / "motion.bvh").write_text(text)


def _joint(name: str, x: int, y: int) -> str:
    channels = "CHANNELS 3 Zrotation Xrotation Yrotation"
    return f"JOINT {name}\n{{\nOFFSET {x} {y} 0\n{channels}\n"


def _write_amass(folder: Path) -> None:
    content = {"poses": np.full((3, 72), 0.1), "trans": np.ones((3, 3))}
    np.savez(folder / "motion.npz", **content, mocap_framerate=np.array(120.0))


def _write_aist(folder: Path) -> None:
    content = {
        "smpl_poses": np.full((3, 72), 0.1, np.float32), "smpl_trans": np.ones((3, 3), np.float32),
        "smpl_scaling": np.array([90.0]), "smpl_loss": np.float64(0.1),
    }  # fmt: skip
    (folder / "motion.pkl").write_bytes(pickle.dumps(content, 2))


def _motion(path: Path) -> object:
    betas = torch.zeros(BODY.shape_dirs.shape[2])
    return read_motion(str(path), BODY, betas, fps=10.0, start=0.0, seconds=1.0)


# --- bodies and poses ---------------------------------------------------------------------------


def _smpl() -> dict[str, object]:
    rng = np.random.default_rng(0)
    parents = np.array([2**32 - 1, *SMPL_PARENTS[1:]], np.uint32)
    return {
        "v_template": rng.normal(size=(4, 3)).astype(np.float32),
        "shapedirs": rng.normal(size=(4, 3, 2)).astype(np.float32),
        "posedirs": np.zeros((4, 3, 207), np.float16),
        "weights": np.full((4, 24), 1 / 24),
        "J_regressor": np.full((24, 4), 0.25, np.float32),
        "kintree_table": np.stack([parents, np.arange(24, dtype=np.uint32)]),
        "f": np.array([[0, 1, 2], [1, 2, 3]], np.uint32),
    }


def _write_smpl_pickle(folder: Path) -> None:
    content = _smpl()
    content["J_regressor"] = sparse.csc_matrix(content["J_regressor"])
    content |= {"bs_type": "lrotmin", "bs_style": "lbs"}
    (folder / "smpl.pkl").write_bytes(pickle.dumps(content, 2))


def _write_given_poses(folder: Path) -> None:
    np.savez(
        folder / "poses.npz",
        global_orient=np.zeros((3, 3)),
        body_pose=np.full((3, 69), 0.1),
        transl=np.ones((3, 3)),
        betas=np.zeros(BODY.shape_dirs.shape[2]),
        viewmats=np.tile(np.eye(4), (3, 1, 1)),
    )


# --- keypoints, masks, pictures, footage --------------------------------------------------------


def _write_openpose(folder: Path) -> None:
    points = [float(10 + index) for index in range(75)]
    frame = {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": points}]}
    for index in range(2):
        (folder / f"frame{index}.json").write_text(json.dumps(frame))


def _write_coco(folder: Path) -> None:
    points = [float(10 + index) for index in range(51)]
    entries = [{"image_id": index, "keypoints": points, "score": 0.9} for index in range(2)]
    (folder / "coco.json").write_text(json.dumps(entries))


def _people(path: Path) -> object:
    return follow_person(read_keypoints(path), str(path))


def _write_masks(folder: Path) -> None:
    mask = np.zeros((6, 8), np.uint8)
    mask[1:5, 2:6] = 255
    soft = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5 + 15
    labels = Image.fromarray(mask // 200, mode="P")
    labels.putpalette([0, 0, 0, 200, 0, 0])
    labels.save(folder / "0.png")
    Image.fromarray(soft).save(folder / "1.png")
    Image.fromarray(np.dstack([mask] * 4)).save(folder / "2.webp", lossless=True)


def _write_pictures(folder: Path, turned: bool = True) -> None:
    write_light(folder / "5.exr", picture(5, 16, 12).astype(np.float32) / 255)
    for index, ending in enumerate(("png", "jpg", "tif", "bmp", "webp")):
        image = Image.fromarray(picture(index, 16, 12))
        exif = Image.Exif()
        exif[0x0112] = 6 if turned else 1
        exif.get_ifd(0x8769)[0xA405] = 28  # focal length on film
        extra = {} if ending == "bmp" else {"exif": exif.tobytes()}
        image.save(folder / f"{index}.{ending}", **extra)


def _read_pictures(folder: Path) -> object:
    """All of them in both ways; the first refusal is the answer."""
    paths = sorted(folder.iterdir())
    read = [read_picture(path) for path in paths]
    return read, [read_mask(path) for path in paths if path.suffix != ".exr"]


def _footage(path: Path) -> object:
    read = read_footage(path, (0, None), 1, 30.0, 8)
    return read, read.interval, focal_of_files(path, read.recorded_size)


def _write_film(folder: Path, ending: str) -> None:
    pictures = [picture(index, 16, 16) for index in range(3)]
    write_video(folder / f"film.{ending}", pictures, metadata={"focal_length_35mm": "28"})


# --- a multi-camera sequence --------------------------------------------------------------------


def _write_annotations(folder: Path) -> None:
    cams = {
        "K": [np.array([[40.0, 0, 4], [0, 40, 3], [0, 0, 1]])] * 2,
        "R": [np.eye(3)] * 2,
        "T": [np.ones((3, 1)) * 1000] * 2,
        "D": [np.zeros((5, 1))] * 2,
    }
    names = [[f"Camera_B{c}/{f:06d}.jpg" for c in (1, 2)] for f in range(FRAMES)]
    np.save(folder / "annots.npy", {"cams": cams, "ims": [{"ims": row} for row in names]})
    for name in {name for row in names for name in row}:
        for part, values in (("", picture(2, 8, 6)), ("mask", picture(2, 8, 6)[..., 0] // 200)):
            path = (folder / part / name).with_suffix(".png" if part else ".jpg")
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(values).save(path)


def _sequence(folder: Path) -> object:
    annotations = read_annotations(folder / "annots.npy")
    numbers = annotations.frame_numbers(range(len(annotations.pictures)), [0, 1])
    name = annotations.pictures[0][0]
    size = picture_size(folder, name)
    masks = mask_folders_here(folder, ("mask",))
    seen = read_person(folder, name, masks, 1, True)
    return vars(annotations) | {"numbers": numbers, "size": size, "seen": seen}


def _write_zju_poses(folder: Path) -> None:
    for part in (zju_poses.PARAMETERS, zju_poses.VERTICES):
        (folder / part).mkdir()
    shapes = np.zeros((1, BODY.shape_dirs.shape[2]))
    for frame in range(2):
        content = {"poses": np.full((1, 72), 0.1), "Rh": np.ones((1, 3)), "Th": np.ones((1, 3))}
        np.save(folder / f"{zju_poses.PARAMETERS}/{frame}.npy", {**content, "shapes": shapes})
        np.save(folder / f"{zju_poses.VERTICES}/{frame}.npy", BODY.vertices.numpy())


READERS: tuple[Reader, ...] = (
    Reader("parameters", _write_parameters, lambda f: check_parameters(f / "params.yaml")),
    Reader("own avatar", _write_avatar, _avatar),
    Reader("numbers of a stage", _write_numbers, lambda f: read_json(f / "fit.json")),
    Reader("metrics", _write_metrics, lambda f: read_results(f, {"s-m": _RUN})),
    Reader("costs", _write_costs, lambda f: read_costs(cost_files(f, _RUN))),
    Reader("moments", _write_moments, _moments),
    Reader("kept snapshots", _write_snapshots, lambda f: run_folder.taken_snapshots(f, (3, 6, 9))),
    Reader("views", _write_views, lambda f: strips_of_scene({"m": f}, 2)),
    *(
        Reader(
            f"artifact {kind.schema}",
            lambda f, kind=kind: example(kind).save(f / "it"),
            lambda f, kind=kind: kind.load(f / "it"),
        )
        for kind in ARTIFACTS
    ),
    Reader("Qualisys", _write_qualisys, lambda f: read_calibration(f / "a.qca.txt", 2)),
    Reader("Pose2Sim", _write_pose2sim, lambda f: read_calibration(f / "a.toml", 2)),
    Reader("COLMAP", _write_colmap, lambda f: read_calibration(f, 2)),
    Reader("COLMAP as text", _write_colmap_text, lambda f: read_calibration(f, 2)),
    Reader("BVH", _write_bvh, lambda f: _motion(f / "motion.bvh")),
    Reader("AMASS", _write_amass, lambda f: _motion(f / "motion.npz")),
    Reader("AIST++", _write_aist, lambda f: _motion(f / "motion.pkl")),
    Reader("SMPL .pkl", _write_smpl_pickle, lambda f: read_smpl(f / "smpl.pkl", 2)),
    Reader(
        "SMPL .npz",
        lambda f: np.savez(f / "smpl.npz", **_smpl()),
        lambda f: read_smpl(f / "smpl.npz", 2),
    ),
    Reader(
        "given poses", _write_given_poses, lambda f: read_poses(f / "poses.npz", (0, 2), 3, BODY)
    ),
    Reader("OpenPose", _write_openpose, _people),
    Reader("COCO", _write_coco, lambda f: _people(f / "coco.json")),
    Reader("masks", _write_masks, lambda f: read_masks(f, (0, 1, 2), 3, (8, 6))),
    Reader("pictures", _write_pictures, _read_pictures),
    Reader("folder of pictures", lambda f: _write_pictures(f, turned=False), _footage),
    Reader("video .mp4", lambda f: _write_film(f, "mp4"), lambda f: _footage(f / "film.mp4")),
    Reader("video .mkv", lambda f: _write_film(f, "mkv"), lambda f: _footage(f / "film.mkv")),
    Reader("ZJU-MoCap", _write_annotations, _sequence),
    Reader("ZJU-MoCap poses", _write_zju_poses, lambda f: zju_poses.read_poses(f, [0, 1], BODY)),
)
