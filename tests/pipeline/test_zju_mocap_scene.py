"""One entry in a parameter file is all that a sequence in ZJU-MoCap's layout needs."""

import json
import math

import pytest
import torch
from ruamel.yaml import YAML

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.rendering.mesh_rendering import View, cast_rays
from tests.process_state import process_state_kept
from tests.stages.running import script_of
from tests.zju_sequence import SHAPES, write_sequence


@pytest.fixture(scope="module", autouse=True)
def this_process():
    with process_state_kept():
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory, tiny_parameters):
    """The parameters with one scene more, and what the stages up to `preprocess` made of it."""
    folder = tmp_path_factory.mktemp("zju_scene")
    sequence = write_sequence(folder, 9)
    scene = {
        "body": "smpl",
        "clip": {
            "source": "zju_mocap", "root": str(sequence.root), "frames": [0, None], "stride": 1,
            "fps": 60.0, "image_height": 128, "train_camera": 0, "test_cameras": [2, 5],
            "test_stride": 3, "pose_cameras": [], "mask_folders": ["mask", "mask_cihp"],
            "mask_dilation": 0, "background": "black", "poses": "new_params", "held_out": 0.0,
        },
        "blur": {"frames": "interpolated", "factor": 8, "window": 9, "averaging_space": "srgb"},
        "preprocess": {
            "poses": "given", "depth": "known", "masks": "given", "background": "none",
            "pose_std_degrees": 1.5, "margin": 0.1, "validation_stride": 10,
        },
    }  # fmt: skip
    smpl = {"source": "smpl", "file": str(sequence.smpl_file), "shape_components": SHAPES}
    run = {"scene": "zju", "observations": "blurred", "avatar": "lean", "method": "lean"}
    content = {
        **tiny_parameters,
        "schedules": {"tiny": {**tiny_parameters["schedules"]["tiny"], "image_height": 128}},
        "bodies": {"smpl": smpl},
        "scenes": {"zju": scene},
        "runs": {"zju-lean": run},
    }
    params_file = folder / "params.yaml"
    with params_file.open("w") as file:
        YAML().dump(content, file)
    shared = {"scene": "zju", "params_file": params_file}
    script_of("body").main(name="smpl", out=folder / "body", params_file=params_file)
    script_of("clip").main(body=folder / "body", out=folder / "clip", **shared)
    script_of("blur").main(clip=folder / "clip/clip", out=folder / "blur", **shared)
    script_of("preprocess").main(
        blur=folder / "blur", body=folder / "body", out=folder / "seen",
        metrics=folder / "seen.json", **shared,
    )  # fmt: skip
    return folder


def test_frames_are_blurred_with_their_masks(folder):
    blurry = BlurryClip.load(folder / "blur")
    assert blurry.frame_indices == tuple(range(1, 8))
    soft = (blurry.mattes > 0) & (blurry.mattes < 255)
    assert soft.any()
    assert blurry.exposure == pytest.approx(9 / 8 / 60)


def test_the_body_fills_what_fitting_sees(folder):
    for name in ("blurred", "sharp"):
        seen = Observations.load(folder / "seen" / name)
        poses = seen.poses
        posed = posed_vertices(
            seen.body, poses.betas, poses.global_orient, poses.body_pose, poses.transl
        )
        assert not seen.cameras.distortion.any()
        view = View.of(seen.cameras, seen.train_camera, samples_per_axis=4)
        for points, matte in zip(posed.double().numpy(), seen.mattes, strict=True):
            rays = view.directions.reshape(-1, 3)
            met = cast_rays(points, seen.body.faces.numpy(), view.centre, rays).triangle >= 0
            grid = torch.from_numpy(met.reshape(view.height, 4, view.width, 4))
            drawn = grid.float().mean((1, 3)) > 0.5
            filled = matte > 127
            assert (drawn & filled).sum() / (drawn | filled).sum() > (
                0.95 if name == "sharp" else 0.9
            )


def test_the_whole_pipeline_runs_to_metrics(folder):
    params_file, seen = folder / "params.yaml", folder / "seen/blurred"
    steps = {"avatar": "lean", "observations": seen, "params_file": params_file}
    metrics, cost = folder / "metrics.json", folder / "cost.json"
    steps |= {"metrics": metrics, "cost": cost}
    script_of("warmup").main(out=folder / "warmup", **steps)
    script_of("trajectory").main(
        method="lean", warmup=folder / "warmup", out=folder / "trajectory", **steps
    )
    script_of("fusion").main(
        method="lean", trajectory=folder / "trajectory", out=folder / "fusion", **steps
    )
    script_of("evaluate").main(
        scene="zju", method="lean", observations=seen,
        reference=folder / "clip/reference", fusion=folder / "fusion",
        out=folder / "evaluate", metrics=metrics, cost=cost, params_file=params_file,
    )  # fmt: skip
    assert len(Avatar.load(folder / "fusion/avatar").means)
    reference = Reference.load(folder / "clip/reference")
    assert reference.frame_indices.tolist() == [0, 3, 6] * 2
    assert math.isfinite(json.loads(metrics.read_text())["image"]["psnr"])
