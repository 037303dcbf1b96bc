import pytest
import torch

from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks
from deblur_avatar.body_estimation.limb_capsules import limb_capsules

pytestmark = pytest.mark.portable

FRAMES, HIP, KNEE = 5, 23, 25


def person() -> Landmarks:
    """Somebody 200 pixels tall who moves 8 pixels a frame to the right."""
    points = torch.zeros(FRAMES, COUNT, 2)
    points[:, :, 1] = torch.linspace(50, 250, COUNT)
    points[:, :, 0] = 100 + 8 * torch.arange(FRAMES)[:, None]
    return Landmarks(
        torch.ones(FRAMES, dtype=torch.bool), points, torch.ones(FRAMES, COUNT),
        torch.zeros(FRAMES, 4, 4, dtype=torch.uint8),
    )  # fmt: skip


def thigh(limbs: torch.Tensor) -> torch.Tensor:
    """The left one's capsules in every frame."""
    return limbs[:, 0]


def test_a_capsule_goes_from_joint_to_joint_at_the_middle_and_halfway_to_its_neighbours():
    seen = person()
    capsules = thigh(limb_capsules(seen))
    assert torch.equal(capsules[2, 1, :2], seen.points[2, HIP])
    assert torch.equal(capsules[2, 1, 3:5], seen.points[2, KNEE])
    assert capsules[2, :, 0].tolist() == [112, 116, 120]
    assert torch.isfinite(capsules[1:-1]).all()


def test_no_shutter_is_told_beyond_the_first_and_the_last_frame():
    limbs = limb_capsules(person())
    assert torch.isfinite(limbs[:, :, 1]).all()
    assert limbs[0, :, 0, :2].isnan().all()
    assert limbs[-1, :, 2, :2].isnan().all()
    assert torch.isfinite(limbs[0, :, 2]).all()


@pytest.mark.parametrize("doubt", ["unsure", "not found"])
def test_what_is_not_sure_is_not_known_in_its_frame_nor_beside(doubt: str):
    seen = person()
    if doubt == "unsure":
        seen.visibility[2, KNEE] = 0.4
    else:
        seen.found[2] = False
    capsules = thigh(limb_capsules(seen))
    assert capsules[2].isnan().any(1).all()
    assert capsules.isnan().any(2).tolist()[1] == [False, False, True]
    assert capsules.isnan().any(2).tolist()[3] == [True, False, False]
    other = limb_capsules(seen)[2, 6]  # the right thigh
    assert torch.isfinite(other).all() == (doubt == "unsure")


def test_the_trunk_goes_from_between_the_shoulders_to_between_the_hips():
    seen = person()
    seen.points[:, 11, 0] += 30
    seen.points[:, 12, 0] -= 10
    trunk = limb_capsules(seen)[2, -2, 1]
    torch.testing.assert_close(trunk[:2], seen.points[2, 11:13].mean(0))
    torch.testing.assert_close(trunk[3:5], seen.points[2, 23:25].mean(0))
    seen.visibility[2, 12] = 0.1
    assert limb_capsules(seen)[2, -2, 1].isnan().any()


def test_hair_is_above_the_ears_as_seen_from_the_shoulders():
    seen = person()
    seen.points[2, [11, 12]] = torch.tensor([[90.0, 120.0], [110.0, 120.0]])
    seen.points[2, [7, 8]] = torch.tensor([[125.0, 70.0], [135.0, 70.0]])  # the head bent aside
    hair = limb_capsules(seen)[2, -1, 1]
    torch.testing.assert_close(hair[:2], torch.tensor([136.0, 60.0]))
    torch.testing.assert_close(hair[3:5], torch.tensor([142.0, 50.0]))
    seen.visibility[2, 12] = 0.1
    assert limb_capsules(seen)[2, -1, 1].isnan().any()


def test_right_limbs_are_the_left_ones_next_landmarks():
    seen = person()
    limbs = limb_capsules(seen)[2, :, 1]
    right = Landmarks(seen.found, seen.points.roll(-1, dims=1), seen.visibility, seen.mattes)
    torch.testing.assert_close(limbs[6:12, :2], limb_capsules(right)[2, :6, 1, :2])
    assert torch.equal(limbs[6:12, 2::3], limbs[:6, 2::3])


def test_radii_go_with_the_person_s_size():
    seen = person()
    small = thigh(limb_capsules(seen))[2, 1]
    large = thigh(
        limb_capsules(
            Landmarks(seen.found, 3 * seen.points, seen.visibility, seen.mattes)
        )
    )[2, 1]  # fmt: skip
    torch.testing.assert_close(large, 3 * small)
    assert 0.02 * 200 < small[5] < small[2] < 0.05 * 200
