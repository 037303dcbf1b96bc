import logging
import re
import shutil

import numpy as np
import pytest
import torch
from PIL import Image

from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.imaging.resampling import undistort
from deblur_avatar.rendering.mesh_rendering import View, cast_rays
from deblur_avatar.sources.zju_mocap.source import load_zju_mocap
from tests.zju_sequence import CAMERAS, SIZE


@pytest.fixture(scope="module")
def vertices(sequence):
    return [torch.from_numpy(points) for points in sequence.vertices]


def outline(points, body, cameras, camera):
    """The body's silhouette as a pinhole camera sees it."""
    view = View.of(cameras, camera, samples_per_axis=1)
    rays = view.directions.reshape(-1, 3)
    hits = cast_rays(points.numpy(), body.faces.numpy(), view.centre, rays)
    return torch.from_numpy((hits.triangle >= 0).reshape(view.height, view.width))


def overlap(a, b):
    """Intersection over union."""
    return float((a & b).sum() / (a | b).sum())


def test_the_posed_body_fills_the_masks(params, smpl):
    clip, _ = load_zju_mocap(params(pose_cameras=[4]), smpl)
    poses = clip.initial
    posed = posed_vertices(
        smpl, poses.betas, poses.global_orient, poses.body_pose, poses.transl
    ).double()
    for row, camera in enumerate(clip.recorded):
        lens = clip.cameras.Ks[camera], clip.cameras.distortion[camera]
        straight = undistort(clip.mattes[row], *lens) > 127
        bent = clip.mattes[row] > 127
        drawn = [outline(points, smpl, clip.cameras, camera) for points in posed]
        shares = [overlap(*pair) for pair in zip(drawn, straight, strict=True)]
        assert min(shares) > 0.96
        assert sum(shares) > sum(overlap(*pair) for pair in zip(drawn, bent, strict=True))


@pytest.mark.parametrize(("size", "least"), [(SIZE, 0.95), (SIZE // 2, 0.9)])
def test_test_views_are_straight_sharp_and_on_black(params, smpl, vertices, size, least):
    clip, reference = load_zju_mocap(params(image_height=size, background="filmed"), smpl)
    assert reference.images.shape == (8 * 2, size, size, 3)
    assert set(reference.camera_indices.tolist()) == set(range(1, CAMERAS))
    assert set(reference.frame_indices.tolist()) == {0, 3}
    for view in range(len(reference.images)):
        points = vertices[int(reference.frame_indices[view])]
        camera = int(reference.camera_indices[view])
        drawn = outline(points, smpl, clip.cameras, camera)
        assert overlap(drawn, reference.mattes[view] > 127) > least
        assert not reference.images[view][reference.mattes[view] == 0].any()
    assert not reference.novel_pose.any()


def test_a_clip_keeps_the_lens_and_the_true_principal_point(params, smpl, sequence):
    clip, _ = load_zju_mocap(params(image_height=SIZE // 2), smpl)
    assert clip.frames.shape == (1, 6, SIZE // 2, SIZE // 2, 3)
    halved = (sequence.Ks[:, :2, 2] + 0.5) / 2
    np.testing.assert_allclose(clip.cameras.Ks[:, :2, 2].numpy(), halved, atol=1e-5)
    assert clip.cameras.distortion.abs().sum() > 0
    assert clip.cameras.sizes.tolist() == [[SIZE // 2, SIZE // 2]] * CAMERAS
    assert not clip.blurred
    assert clip.held_out_from == 6


def test_the_background_is_black_or_as_filmed(params, smpl):
    black, _ = load_zju_mocap(params(), smpl)
    filmed, _ = load_zju_mocap(params(background="filmed"), smpl)
    outside = black.mattes == 0
    assert not black.frames[outside].any()
    assert filmed.frames[outside].float().mean() > 60
    assert torch.equal(black.frames[black.mattes == 255], filmed.frames[filmed.mattes == 255])


def test_frames_and_stride_choose_pictures_times_and_poses(params, smpl):
    whole, _ = load_zju_mocap(params(), smpl)
    part, reference = load_zju_mocap(params(frames=[1, 6], stride=2, test_stride=2), smpl)
    assert torch.equal(part.frames[0], whole.frames[0, [1, 3, 5]])
    assert torch.equal(part.initial.transl, whole.initial.transl[[1, 3, 5]])
    torch.testing.assert_close(part.timestamps, torch.arange(3) / 30)
    assert set(reference.frame_indices.tolist()) == {0, 2}


def test_only_cameras_that_are_used_are_kept(params, smpl):
    clip, reference = load_zju_mocap(
        params(train_camera=5, test_cameras=[7, 2], pose_cameras=[3]), smpl
    )
    names = ("Camera_B3", "Camera_B4", "Camera_B6", "Camera_B8")
    assert clip.cameras.names == names
    assert names[clip.train_camera] == "Camera_B6"
    assert [names[camera] for camera in clip.recorded] == ["Camera_B6", "Camera_B4"]
    assert {names[c] for c in reference.camera_indices.tolist()} == {"Camera_B8", "Camera_B3"}
    alone, _ = load_zju_mocap(params(train_camera=3, test_cameras=[1]), smpl)
    assert torch.equal(clip.frames[1], alone.frames[0])


def test_the_last_part_can_be_held_out(params, smpl):
    clip, reference = load_zju_mocap(params(held_out=0.5), smpl)
    assert clip.held_out_from == 3
    assert torch.equal(reference.novel_pose.bool(), reference.frame_indices >= 3)


def test_poses_can_be_left_to_estimation(params, root, smpl):
    shutil.rmtree(root / "new_params")
    clip, _ = load_zju_mocap(params(root=str(root), poses="none"), smpl)
    assert clip.initial is None
    with pytest.raises(ArtifactError, match=r"no 0\.npy, 0 of 6 frames"):
        load_zju_mocap(params(root=str(root)), smpl)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": [0, 7]}, "clip.frames: 0 to 7 in steps of 1 .* more of the 6 that .*annots"),
        ({"frames": [5, 6]}, "clip.frames: 5 to 6 in steps of 1 must be two frames or more"),
        ({"train_camera": 9}, r"clip.train_camera: \[9\] must be different ones of .* 9 cameras"),
        ({"test_cameras": [1, 9]}, r"clip.test_cameras: \[1, 9\] must be different ones"),
        ({"test_cameras": [1, 1]}, r"clip.test_cameras: \[1, 1\] must be different ones"),
        ({"test_cameras": [0, 1]}, "without the training camera 0"),
        ({"test_cameras": []}, r"clip.test_cameras: \[\] must be one camera or more"),
        ({"pose_cameras": [0]}, "clip.pose_cameras: the training camera 0 is recorded anyway"),
        ({"root": "/nowhere"}, "clip.root: no folder /nowhere; set clip.root in params.yaml to"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(params, smpl, changes, message):
    with pytest.raises(ConfigError, match=message):
        load_zju_mocap(params(**changes), smpl)


def test_a_missing_variable_says_what_belongs_there(params, smpl, monkeypatch):
    monkeypatch.delenv("ZJU_MOCAP_ROOT", raising=False)
    where = params(root="${ZJU_MOCAP_ROOT}/CoreView_377")
    with pytest.raises(ConfigError, match="set the environment variable ZJU_MOCAP_ROOT.*annots"):
        load_zju_mocap(where, smpl)
    monkeypatch.setenv("ZJU_MOCAP_ROOT", "/nowhere")
    with pytest.raises(ConfigError, match="no folder /nowhere/CoreView_377; set ZJU_MOCAP_ROOT"):
        load_zju_mocap(where, smpl)


def test_a_camera_of_another_size_is_named(params, root, smpl):
    for part, suffix in (("", "jpg"), ("mask/", "png"), ("mask_cihp/", "png")):
        path = root / f"{part}Camera_B4/000003.{suffix}"
        Image.open(path).resize((48, 48), Image.Resampling.NEAREST).save(path)
    found = re.escape("Camera_B4/000003.jpg has 48 x 48 pixels, other pictures 128 x 128")
    with pytest.raises(ArtifactError, match=found):
        load_zju_mocap(params(root=str(root)), smpl)


def test_a_picture_that_is_not_there_is_named(params, root, smpl):
    (root / "Camera_B1/000002.jpg").unlink()
    with pytest.raises(ArtifactError, match=r"cannot read .*Camera_B1/000002.jpg: No such file"):
        load_zju_mocap(params(root=str(root)), smpl)


def test_a_picture_that_repeats_is_told(params, root, smpl, caplog):
    for part, suffix in (("", "jpg"), ("mask/", "png"), ("mask_cihp/", "png")):
        folder = root / f"{part}Camera_B1"
        shutil.copy(folder / f"000002.{suffix}", folder / f"000003.{suffix}")
    with caplog.at_level(logging.WARNING):
        load_zju_mocap(params(root=str(root)), smpl)
    assert "1 frames repeat the picture before them: 3" in caplog.text
