import math

import pytest
import torch

from deblur_avatar.geometry.cameras import camera_centres, look_at, project
from deblur_avatar.sources.studio.hand_held import BOB, CameraPath, HandHeldParams, camera_path

EYE, TARGET, SECONDS = (0.0, 1.4, 4.0), (0.0, 0.9, 0.0), 20.0
TIMES = torch.linspace(0, SECONDS, 4001, dtype=torch.float64)
SPARSE = TIMES[::10]
STEADY = HandHeldParams(sway_mm=0.0, shake_degrees=0.0, pan_degrees=0.0, walk_m=0.0)


def path(**changes: float) -> CameraPath:
    params = STEADY.model_copy(update=changes)
    return camera_path(EYE, TARGET, SECONDS, params, torch.Generator().manual_seed(0))


def angles(viewmats: torch.Tensor) -> torch.Tensor:
    """Degrees between each camera's axes and those of a tripod at the same eye."""
    eyes = camera_centres(viewmats)
    up, target = torch.tensor([0.0, 1.0, 0.0]).double(), torch.tensor(TARGET).double()
    still = torch.stack([look_at(eye, target, up)[:3, :3] for eye in eyes])
    cosine = ((viewmats[:, :3, :3] @ still.mT).diagonal(dim1=1, dim2=2).sum(1) - 1) / 2
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))


def test_a_tripod_stands_still():
    tripod = camera_path(EYE, TARGET, SECONDS, None, torch.Generator().manual_seed(0))
    assert (tripod.viewmats(TIMES[:9]) == tripod.viewmats(TIMES[:1])).all()


def test_a_steady_hand_is_a_tripod():
    centres = camera_centres(path().viewmats(TIMES[:9]))
    torch.testing.assert_close(centres, torch.tensor(EYE).double().expand(9, 3), atol=1e-6, rtol=0)


def test_sway_moves_the_eye_by_as_much_as_asked_for():
    away = camera_centres(path(sway_mm=20.0).viewmats(SPARSE)) - torch.tensor(EYE)
    assert float(away.square().sum(1).mean().sqrt()) == pytest.approx(0.02, rel=0.1)


def test_shake_turns_the_camera_by_as_much_as_asked_for_and_leaves_it_in_its_place():
    viewmats = path(shake_degrees=0.5).viewmats(SPARSE)
    assert float(angles(viewmats).square().mean().sqrt()) == pytest.approx(0.5, rel=0.1)
    assert (camera_centres(viewmats) - torch.tensor(EYE)).abs().max() < 1e-5


def test_a_pan_turns_evenly_and_has_the_person_in_the_middle_half_way():
    viewmats = path(pan_degrees=10.0).viewmats(TIMES[[0, 2000, 4000]])
    assert angles(viewmats).tolist() == pytest.approx([5, 0, 5], abs=1e-3)
    K = torch.tensor([[500.0, 0, 0], [0, 500, 0], [0, 0, 1]]).double()
    person = torch.tensor([TARGET]).double()
    x = [float(project(person, K, viewmats[index])[0][0, 0]) for index in (0, 2)]
    assert x[0] == pytest.approx(-x[1])
    assert abs(x[0]) == pytest.approx(500 * math.tan(math.radians(5)), rel=1e-3)


def test_a_walk_passes_the_person_and_keeps_looking_at_her():
    viewmats = path(walk_m=2.0).viewmats(TIMES[::4])
    centres = camera_centres(viewmats)
    assert centres[[0, -1], 0].tolist() == pytest.approx([-1, 1], abs=1e-6)
    assert float((centres[:, 1] - EYE[1]).abs().max()) == pytest.approx(BOB, rel=0.01)
    assert angles(viewmats[::3]).max() < 1e-3


def test_the_way_is_smooth_and_the_same_for_the_same_seed():
    held = path(sway_mm=20.0, shake_degrees=0.5, walk_m=1.0)
    steps = camera_centres(held.viewmats(TIMES)).diff(dim=0).norm(dim=1)
    assert steps.max() < 0.002  # in 5 ms
    again = path(sway_mm=20.0, shake_degrees=0.5, walk_m=1.0)
    assert torch.equal(held.viewmats(TIMES[:5]), again.viewmats(TIMES[:5]))
