import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.geometry.skinning import skin_points
from deblur_avatar.sources.studio.clothes import Clothed, clothe
from deblur_avatar.sources.studio.drape import Drape, hang

REST = np.tile(np.eye(4, dtype=np.float32), (24, 1, 1))
STRAIGHT = np.zeros(24, np.float32)


@pytest.fixture(scope="module")
def clothed(body: Body) -> Clothed:
    return clothe(
        body.vertices.double().numpy(),
        body.joints.double().numpy(),
        body.lbs_weights.double().numpy(),
        body.faces.numpy(),
    )


@pytest.fixture(scope="module")
def drape(clothed: Clothed) -> Drape:
    return hang(clothed)


def turned(angle: float) -> np.ndarray:
    """The whole body turned about X."""
    transforms = REST.copy()
    c, s = np.cos(angle), np.sin(angle)
    transforms[:, :3, :3] = np.float32([[1, 0, 0], [0, c, -s], [0, s, c]])
    return transforms


def test_at_rest_cloth_stays_almost_where_it_was_sewn(drape: Drape):
    moved = np.linalg.norm(drape.skinned(REST, STRAIGHT) - drape.vertices, axis=1)
    assert moved.max() < 0.0015  # it rests softly on what is below


def test_skin_follows_the_body_exactly(clothed: Clothed, drape: Drape):
    rng = np.random.default_rng(0)
    transforms = REST.copy()
    transforms[:, :3, 3] = rng.uniform(-0.2, 0.2, (24, 3))
    bends = rng.uniform(0, 1, 24).astype(np.float32)
    wanted = skin_points(
        torch.from_numpy(drape.vertices),
        torch.from_numpy(drape.lbs_weights),
        torch.from_numpy(transforms),
    ).numpy()
    found = drape.skinned(transforms, bends)
    skin = drape.slack == 0
    np.testing.assert_allclose(found[skin], wanted[skin], atol=1e-6)
    assert np.abs(found - wanted)[~skin].max() > 0.002


def test_lying_down_lets_loose_cloth_sag_to_the_ground(drape: Drape):
    back = turned(-np.pi / 2)  # lies on its back: rest +Z is up, rest -Z is down
    offset = drape.skinned(back, STRAIGHT) - drape.vertices @ back[0, :3, :3].T
    loose = drape.sag > 0.03
    below = loose & (drape.normals[:, 2] < -0.8)
    above = loose & (drape.normals[:, 2] > 0.8)
    assert offset[below, 1].mean() < -0.02
    assert (offset[below, 1] < 0).all()
    assert (offset[above, 1] < 0).all()


def test_cloth_never_sinks_below_its_slack(drape: Drape):
    for angle in np.linspace(0, 2 * np.pi, 7):
        transforms = turned(float(angle))
        inverse = transforms[0, :3, :3]
        points = drape.skinned(transforms, np.ones(24, np.float32)) @ inverse
        lift = ((points - drape.vertices) * drape.normals).sum(1)
        assert (lift >= -drape.slack - 1e-6).all()


def test_turning_about_the_vertical_changes_nothing(drape: Drape):
    transforms = REST.copy()
    c, s = np.cos(1.1), np.sin(1.1)
    transforms[:, :3, :3] = np.float32([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    found = drape.skinned(transforms, STRAIGHT) @ transforms[0, :3, :3]
    np.testing.assert_allclose(found, drape.skinned(REST, STRAIGHT), atol=1e-5)


def test_a_bent_hip_folds_the_shorts_around_it_and_nothing_far_away(drape: Drape, body: Body):
    bends = STRAIGHT.copy()
    bends[SMPL_JOINT_NAMES.index("left_hip")] = 0.5
    moved = np.linalg.norm(drape.skinned(REST, bends) - drape.skinned(REST, STRAIGHT), axis=1)
    away = np.linalg.norm(drape.vertices - body.joints[1].numpy(), axis=1)
    assert moved[away < 0.15].max() > 0.003
    assert moved[away > 0.7].max() < 1e-5


def test_cloth_moves_smoothly_with_the_pose(drape: Drape):
    angles = np.linspace(0, 1, 41)
    path = np.stack([drape.skinned(turned(float(a)), np.float32(a) + STRAIGHT) for a in angles])
    speed = np.diff(path, axis=0)
    jerk = np.linalg.norm(np.diff(speed, axis=0), axis=-1)
    assert jerk.max() < 0.15 * np.linalg.norm(speed, axis=-1).max()
