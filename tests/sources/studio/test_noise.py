import torch

from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.sources.studio.motion import Moves, move
from deblur_avatar.sources.studio.noise import correlated_noise, disturb
from tests.randomness import seeded

TIMES = torch.arange(200, dtype=torch.float64) / 60


def angles(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Degrees between rotations given as axis-angle vectors."""
    between = axis_angle_to_matrix(first).transpose(-1, -2) @ axis_angle_to_matrix(second)
    cosine = (between.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))


def both(moves: Moves) -> torch.Tensor:
    return torch.cat([moves.global_orient[:, None], moves.body_pose], 1)


def test_noise_has_unit_variance_and_the_correlation_asked_for():
    noise = correlated_noise(TIMES, 0.1, 4000, seeded())
    torch.testing.assert_close(noise.var(1), torch.ones(200).double(), atol=0.12, rtol=0)
    for lag in (1, 6, 30):
        wanted = torch.exp(torch.tensor(-lag / 60 / 0.1))
        found = (noise[lag:] * noise[:-lag]).mean()
        assert abs(found - wanted) < 0.02


def test_without_correlation_frames_are_independent():
    noise = correlated_noise(TIMES, 0.0, 2000, seeded())
    assert abs((noise[1:] * noise[:-1]).mean()) < 0.02


def test_joints_err_by_the_angle_asked_for_and_the_root_by_the_distance():
    true = move("turn", TIMES, 2.0)
    wrong = disturb(true, TIMES, 1.5, 5.0, 0.1, seeded())
    error = angles(both(true), both(wrong))
    assert abs(error.square().mean().sqrt() - 1.5) < 0.08
    assert abs(error[:, 0].square().mean().sqrt() - 1.5) < 0.4  # the root too
    distance = (wrong.transl - true.transl).norm(dim=1) * 1000
    assert abs(distance.square().mean().sqrt() - 5.0) < 1.0


def test_neighbouring_frames_err_alike():
    true = move("turn", TIMES, 2.0)
    error = both(disturb(true, TIMES, 1.5, 5.0, 0.1, seeded())) - both(true)
    arm = error[:, 16]
    assert torch.corrcoef(torch.stack([arm[1:, 0], arm[:-1, 0]]))[0, 1] > 0.5


def test_no_noise_leaves_the_truth():
    true = move("turn", TIMES, 2.0)
    same = disturb(true, TIMES, 0.0, 0.0, 0.1, seeded())
    assert torch.equal(both(same), both(true))
    assert torch.equal(same.transl, true.transl)


def test_one_kind_of_noise_does_not_touch_the_other():
    true = move("turn", TIMES, 2.0)
    assert torch.equal(disturb(true, TIMES, 2.0, 0.0, 0.1, seeded()).transl, true.transl)
    assert torch.equal(both(disturb(true, TIMES, 0.0, 9.0, 0.1, seeded())), both(true))


def test_the_seed_decides():
    true = move("still", TIMES, 2.0)
    first, again, other = (disturb(true, TIMES, 1.0, 1.0, 0.1, seeded(s)) for s in (1, 1, 2))
    assert torch.equal(first.body_pose, again.body_pose)
    assert not torch.equal(first.body_pose, other.body_pose)
