import dataclasses
import logging
import re

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.bodies.smpl import read_smpl
from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.zju_mocap.poses import read_poses

NUMBERS = range(6)


@pytest.fixture
def change(root):
    """Change a frame's parameters."""

    def apply(frame, **changes):
        path = root / f"new_params/{frame}.npy"
        content = np.load(path, allow_pickle=True).item()
        np.save(path, {**content, **changes})
        return root

    return apply


def bodies(smpl, poses):
    return posed_vertices(smpl, poses.betas, poses.global_orient, poses.body_pose, poses.transl)


def test_the_body_stands_where_the_vertices_are(sequence, smpl):
    assert smpl.joints[0].norm() > 0.2  # else both conventions were one
    posed = bodies(smpl, read_poses(sequence.root, NUMBERS, smpl))
    np.testing.assert_allclose(posed.numpy(), np.stack(sequence.vertices), atol=2e-5)


def test_poses_without_a_root_are_the_same(sequence, root, smpl, change):
    before = read_poses(sequence.root, NUMBERS, smpl)
    content = np.load(root / "new_params/2.npy", allow_pickle=True).item()
    change(2, poses=content["poses"][:, 3:], Rh=content["Rh"].ravel())
    after = read_poses(root, NUMBERS, smpl)
    torch.testing.assert_close(after.body_pose, before.body_pose)
    torch.testing.assert_close(after.transl, before.transl)


def test_a_turn_of_the_root_adds_to_the_turn_about_the_origin(sequence, root, smpl, change):
    content = np.load(root / "new_params/2.npy", allow_pickle=True).item()
    poses = content["poses"].copy()
    poses[0, :3] = [0.3, -0.2, 0.5]
    change(2, poses=poses)
    read = read_poses(root, [2], smpl)
    turned = torch.tensor(poses[0].reshape(24, 3), dtype=torch.float32)
    betas = torch.tensor(content["shapes"][0])
    rest = posed_vertices(smpl, betas, turned[0], turned[1:], torch.zeros(3))
    rotation = Rotation.from_rotvec(content["Rh"][0]).as_matrix()
    wanted = rest.numpy() @ rotation.T + content["Th"]
    np.testing.assert_allclose(bodies(smpl, read)[0].numpy(), wanted, atol=2e-5)


def test_fewer_parameters_than_frames_are_refused_with_what_to_do(root, smpl):
    for frame in (4, 5):
        (root / f"new_params/{frame}.npy").unlink()
    with pytest.raises(ArtifactError, match=r"no 4\.npy, 4 of 6 frames.*set clip\.poses to none"):
        read_poses(root, NUMBERS, smpl)
    assert len(read_poses(root, range(4), smpl).transl) == 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": np.zeros((1, 66))}, r"wanted 72 \(or 69\) poses, .*got 66, 3, 3 and 10"),
        ({"Th": np.zeros(2)}, "got 72, 3, 2 and 10"),
        ({"Rh": np.full((1, 3), np.inf)}, "2.npy holds values that are not finite"),
        ({"shapes": "tall"}, "2.npy: .*could not convert"),
    ],
)
def test_damaged_parameters_are_refused(change, smpl, changes, message):
    with pytest.raises(ArtifactError, match=message):
        read_poses(change(2, **changes), NUMBERS, smpl)


def test_parameters_that_lack_a_key_are_refused(root, smpl):
    np.save(root / "new_params/2.npy", {"poses": np.zeros((1, 72))})
    with pytest.raises(ArtifactError, match="2.npy: wanted poses, Rh, Th, shapes, got poses"):
        read_poses(root, NUMBERS, smpl)
    np.save(root / "new_params/2.npy", np.zeros(3))
    with pytest.raises(ArtifactError, match="2.npy: wanted poses, Rh, Th, shapes, got an array"):
        read_poses(root, NUMBERS, smpl)


def test_more_shape_numbers_than_the_body_has_are_refused_unless_zero(sequence, root, smpl, change):
    small = read_smpl(sequence.smpl_file, 3)
    assert len(read_poses(root, NUMBERS, small).betas) == 3
    for frame in NUMBERS:
        change(frame, shapes=np.ones((1, 10)))
    with pytest.raises(ArtifactError, match="10 numbers, the body 3; set .* to 10"):
        read_poses(root, NUMBERS, small)


def test_a_shape_that_changes_is_told_and_the_first_taken(root, smpl, change, caplog):
    change(3, shapes=np.ones((1, 10)))
    with caplog.at_level(logging.WARNING):
        poses = read_poses(root, NUMBERS, smpl)
    assert "shapes change by up to 1.500; the first is used" in caplog.text
    assert float(poses.betas[0]) == pytest.approx(0.6)


def test_a_body_of_other_vertices_is_refused(root, smpl, body):
    np.save(root / "new_vertices/0.npy", np.zeros((6890, 3)))
    with pytest.raises(ArtifactError, match=r"got \[6890, 3\]; the scene's body must be the SMPL"):
        read_poses(root, NUMBERS, smpl)


def test_a_body_that_stands_elsewhere_is_told(root, smpl, caplog):
    wider = dataclasses.replace(smpl, vertices=smpl.vertices * 1.2)
    with caplog.at_level(logging.WARNING):
        read_poses(root, NUMBERS, smpl)
        assert not caplog.text
        read_poses(root, NUMBERS, wider)
    assert "mm from" in caplog.text


def test_the_last_frame_s_vertices_are_compared_too(sequence, root, smpl, caplog):
    np.save(root / "new_vertices/5.npy", sequence.vertices[5] + [0, 0, 0.5])
    with caplog.at_level(logging.WARNING):
        read_poses(root, NUMBERS, smpl)
    assert re.search(r"frame 5: the body is 500\.\d\d mm from .*new_vertices/5\.npy", caplog.text)


@pytest.mark.parametrize("name", ["new_params/2.npy", "new_vertices/0.npy"])
def test_files_reached_through_a_link_are_refused(root, smpl, tmp_path, name):
    (root / name).rename(tmp_path / "elsewhere.npy")
    (root / name).symlink_to(tmp_path / "elsewhere.npy")
    with pytest.raises(ArtifactError, match=f"'{name}' leads out of"):
        read_poses(root, NUMBERS, smpl)
