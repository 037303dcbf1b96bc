import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import posed_joints
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import look_at, project
from deblur_avatar.sources.given_poses import read_poses
from tests.walking_person import walking_poses

FRAMES = 4
K = torch.tensor([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])


@pytest.fixture
def arrays(body: Body) -> dict[str, np.ndarray]:
    poses = walking_poses(body, FRAMES)
    return {
        "betas": poses.betas.numpy(),
        "global_orient": poses.global_orient.numpy(),
        "body_pose": poses.body_pose.numpy(),
        "transl": poses.transl.numpy(),
    }


def moving_cameras() -> torch.Tensor:
    up, centre = torch.tensor([0.0, 1.0, 0.0]), torch.zeros(3)
    eyes = [torch.tensor([0.5 * step, 0.3, 3.0 + 0.1 * step]) for step in range(FRAMES)]
    return torch.stack([look_at(eye, centre, up) for eye in eyes])


def test_poses_are_those_of_the_frames_taken(tmp_path: Path, body: Body, arrays):
    np.savez(tmp_path / "a.npz", **arrays)
    poses = read_poses(tmp_path / "a.npz", (1, 3), FRAMES, body)
    assert torch.equal(poses.transl, torch.from_numpy(arrays["transl"][[1, 3]]))
    assert torch.equal(poses.body_pose, torch.from_numpy(arrays["body_pose"][[1, 3]]))


def test_frames_without_a_pose_get_one_from_the_frames_around(tmp_path: Path, body: Body, arrays):
    whole = dict(arrays)
    for name in ("global_orient", "body_pose", "transl"):
        arrays[name] = arrays[name].copy()
        arrays[name][[0, 2]] = np.nan
    np.savez(tmp_path / "a.npz", **arrays)
    poses = read_poses(tmp_path / "a.npz", (1, 2, 3), FRAMES, body)
    between = torch.from_numpy((whole["transl"][1] + whole["transl"][3]) / 2)
    torch.testing.assert_close(poses.transl[1], between)
    assert torch.equal(poses.body_pose[0], torch.from_numpy(whole["body_pose"][1]))
    with pytest.raises(ArtifactError, match="have no pose, the first or the last among them"):
        read_poses(tmp_path / "a.npz", (0, 1, 3), FRAMES, body)


def test_flat_poses_and_poses_in_one_array_are_read_alike(tmp_path: Path, body: Body, arrays):
    np.savez(tmp_path / "a.npz", **arrays)
    flat = arrays["body_pose"].reshape(FRAMES, -1)
    whole = np.concatenate([arrays.pop("global_orient"), flat], axis=1)
    del arrays["body_pose"]
    np.savez(tmp_path / "b.npz", poses=whole, **arrays)
    a, b = (read_poses(tmp_path / f"{name}.npz", (0, 2), FRAMES, body) for name in "ab")
    assert torch.equal(a.body_pose, b.body_pose)
    assert torch.equal(a.global_orient, b.global_orient)


def test_a_moving_camera_s_way_becomes_the_body_s(tmp_path: Path, body: Body, arrays):
    # SMPL's pelvis rests off the origin.
    body = dataclasses.replace(body, joints=body.joints + torch.tensor([0.1, -0.24, 0.05]))
    viewmats = moving_cameras()
    np.savez(tmp_path / "a.npz", viewmats=viewmats.numpy(), **arrays)
    still = read_poses(tmp_path / "a.npz", tuple(range(FRAMES)), FRAMES, body)
    moving = walking_poses(body, FRAMES)
    seen = posed_joints(body, still.betas, still.global_orient, still.body_pose, still.transl)
    world = posed_joints(body, moving.betas, moving.global_orient, moving.body_pose, moving.transl)
    for frame in range(FRAMES):
        wanted = project(world[frame], K, viewmats[frame])
        found = project(seen[frame], K, torch.eye(4))
        torch.testing.assert_close(found[0], wanted[0], atol=1e-3, rtol=0)
        torch.testing.assert_close(found[1], wanted[1], atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("transl", np.zeros((FRAMES - 1, 3)), r"transl is \[3, 3\], wanted \[4, 3\]"),
        ("body_pose", np.zeros((FRAMES, 21, 3)), r"body_pose is \[4, 21, 3\], wanted \[4, 23, 3\]"),
        ("global_orient", np.full((FRAMES, 3), np.nan), "global_orient holds values that are not"),
        ("betas", np.zeros(300), "betas are 300 numbers, the body has"),
        ("viewmats", np.zeros((FRAMES, 4, 4)), "is not a rotation matrix"),
        ("viewmats", np.zeros((2, 4, 4)), r"viewmats is \[2, 4, 4\], wanted \[4, 4, 4\]"),
        ("transl", None, "has no transl"),
        ("betas", np.array(["a"]), r"is no \.npz of numbers"),
        ("betas", np.array([{"a": 1}], dtype=object), r"is no \.npz of numbers"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(
    tmp_path: Path, body: Body, arrays, name: str, value: np.ndarray | None, message: str
):
    changed = {**arrays, name: value}
    np.savez(tmp_path / "a.npz", **{k: v for k, v in changed.items() if v is not None})
    with pytest.raises(ArtifactError, match=message):
        read_poses(tmp_path / "a.npz", (0, 1), FRAMES, body)


def test_files_that_are_not_there_or_damaged_are_refused(tmp_path: Path, body: Body):
    with pytest.raises(ArtifactError, match="check clip.poses"):
        read_poses(tmp_path / "no.npz", (0,), 1, body)
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 cut off")
    with pytest.raises(ArtifactError, match=r"a\.npz is no \.npz of numbers"):
        read_poses(tmp_path / "a.npz", (0,), 1, body)
