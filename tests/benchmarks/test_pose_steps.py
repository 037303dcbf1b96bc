"""What true inputs of the body fit bring, on a capsule person whom a detector half misses."""

import dataclasses

import pytest
import torch

from benchmarks.pose_steps import FITS, Truth, errors, with_truth
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation import body_fit
from deblur_avatar.body_estimation.body_landmarks import landmark_map
from tests.randomness import seeded
from tests.walking_person import FPS, SIZE, detect_perfectly, ring_of_cameras, walking_poses

FRAMES = 8
ROWS = list(landmark_map().rows)


@pytest.fixture(scope="module")
def perfect(body):
    return detect_perfectly(body, walking_poses(body, FRAMES), ring_of_cameras(), 0)


@pytest.fixture(scope="module")
def clip():
    cameras = ring_of_cameras()
    wrong = cameras.Ks.clone()
    wrong[:, :2, :2] *= 1.2
    return BlurryClip(
        frames=torch.zeros(1, FRAMES, SIZE[1], SIZE[0], 3, dtype=torch.uint8), mattes=None,
        sharp_frames=None, sharp_mattes=None, recorded=(0,), train_camera=0,
        cameras=dataclasses.replace(cameras, Ks=wrong), frame_indices=tuple(range(FRAMES)),
        timestamps=torch.arange(FRAMES) / FPS, exposure=None, averaging_space="linear",
        held_out_from=FRAMES, initial=None, exact=None,
    )  # fmt: skip


@pytest.fixture(scope="module")
def truth(body, perfect):
    focal = float(ring_of_cameras().Ks[0, 0, 0])
    return Truth(walking_poses(body, FRAMES), focal, perfect.mattes)


@pytest.fixture(scope="module")
def seen(perfect):
    """Landmarks off by pixels, depth by centimetres, a matte without its right half."""
    mattes = perfect.mattes.clone()
    mattes[..., SIZE[0] // 2 :] = 0
    drawn = torch.randn(perfect.world.shape, generator=seeded())
    return dataclasses.replace(
        perfect, points=perfect.points + 3 * drawn[..., :2], world=perfect.world + 0.1 * drawn,
        visibility=0.8 * perfect.visibility, mattes=mattes,
    )  # fmt: skip


def test_true_parts_are_what_a_perfect_detector_sees_and_the_rest_stays(
    body, clip, seen, truth, perfect
):
    there, person = with_truth(clip, body, seen, truth, ("points",))
    assert torch.equal(there.cameras.Ks, clip.cameras.Ks)
    torch.testing.assert_close(person.points[:, ROWS], perfect.points[:, ROWS])
    assert (person.visibility == 1).all()
    assert torch.equal(person.world, seen.world)
    assert torch.equal(person.mattes, seen.mattes)
    there, person = with_truth(clip, body, seen, truth, ("focal", "mattes", "world"))
    torch.testing.assert_close(there.cameras.Ks[0], ring_of_cameras().Ks[0])
    assert torch.equal(there.cameras.Ks[1:], clip.cameras.Ks[1:])
    torch.testing.assert_close(person.world[:, ROWS], perfect.world[:, ROWS])
    assert torch.equal(person.mattes, perfect.mattes)
    assert torch.equal(person.points, seen.points)


def test_the_more_is_true_the_nearer_is_the_fitted_body(body, clip, seen, truth, monkeypatch):
    for name, value in {"COARSE_STEPS": 80, "FINE_STEPS": 40, "SURFACE_POINTS": 300}.items():
        monkeypatch.setattr(body_fit, name, value)
    true = posed(body, truth.poses).joints
    found = {
        name: errors(*_given(clip, body, seen, truth, FITS[name]), true)["registered_mm"]
        for name in ("as estimated", "true landmarks and guess", "all true")
    }
    assert found["all true"] < found["as estimated"] / 2
    assert found["true landmarks and guess"] < found["as estimated"]


def _given(clip, body, seen, truth, parts):
    there, person = with_truth(clip, body, seen, truth, parts)
    return there, body, person
