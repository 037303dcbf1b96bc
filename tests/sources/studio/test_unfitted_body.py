import math

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.sources.studio.drape import SAG
from deblur_avatar.sources.studio.motion import Moves, move
from deblur_avatar.sources.studio.person import create_person
from deblur_avatar.sources.studio.unfitted_body import (
    DAMPING,
    GRAVITY,
    SWING_HZ,
    UnfittedParams,
    swing_of_joints,
    unfitted_body,
    with_more_hair,
)

SAME = UnfittedParams(shape_mm=0.0, weight_rounds=0, swing=0.0, hair_mm=0.0)
HEAD = SMPL_JOINT_NAMES.index("head")
TIMES = torch.arange(2000, dtype=torch.float64) / 500


def made(body: Body, **changes: object) -> Body:
    return unfitted_body(body, SAME.model_copy(update=changes), torch.Generator().manual_seed(0))


def slid(body: Body, x: torch.Tensor) -> Moves:
    """A person at rest who is pushed sideways."""
    count = len(x)
    joints = len(body.parents)
    zero = torch.zeros(count, 3, dtype=torch.float64)
    place = torch.stack([x, 0 * x, 0 * x], -1)
    return Moves(zero, torch.zeros(count, joints - 1, 3, dtype=torch.float64), place)


def swing(body: Body, x: torch.Tensor) -> torch.Tensor:
    betas = torch.zeros(body.shape_dirs.shape[2])
    return swing_of_joints(body, betas, slid(body, x), TIMES)


def test_nothing_asked_for_is_the_body_itself(body: Body):
    same = made(body)
    torch.testing.assert_close(same.vertices, body.vertices, atol=1e-7, rtol=0)
    assert torch.equal(same.lbs_weights, body.lbs_weights)


def test_the_surface_is_another_and_the_joints_are_not(body: Body):
    other = made(body, shape_mm=8.0)
    away = (other.vertices - body.vertices).norm(dim=1)
    assert float(away.square().mean().sqrt()) == pytest.approx(0.008, rel=0.35)
    betas = torch.ones(body.shape_dirs.shape[2])
    assert torch.equal(shaped_joints(other, betas), shaped_joints(body, betas))


def test_weights_are_other_weights(body: Body):
    other = made(body, weight_rounds=6)
    torch.testing.assert_close(other.lbs_weights.sum(1), torch.ones(len(body.vertices)))
    assert float((other.lbs_weights - body.lbs_weights).abs().max()) > 0.05
    assert other.lbs_weights.min() >= 0


def test_more_hair_stands_out_from_the_head_and_nothing_else_moves(body: Body):
    person = create_person(body, torch.zeros(body.shape_dirs.shape[2]))
    hairy = with_more_hair(person, 25.0)
    away = np.linalg.norm(hairy.drape.vertices - person.drape.vertices, axis=1)
    on_head = person.drape.lbs_weights[:, HEAD] > 0.5
    loose = person.drape.sag > 0.5 * SAG
    assert away[on_head & loose].min() > 0.01
    assert away.max() < 0.0251
    assert away[~on_head].max() == 0


def test_cloth_lags_behind_a_steady_pull(body: Body):
    lag = swing(body, 0.5 * 2.0 * TIMES**2)  # 2 m/s^2 to the left
    assert lag[-1, :, 0].tolist() == pytest.approx([-2.0 / GRAVITY] * 24, rel=0.02)
    assert lag[..., 1:].abs().max() < 1e-9


def test_cloth_swings_on_at_its_own_rate_and_comes_to_rest(body: Body):
    pushed = 0.02 * torch.sigmoid((TIMES - 0.2) / 0.01)
    after = swing(body, pushed)[150:, 0, 0]
    crossings = torch.nonzero(after[:-1].sign() != after[1:].sign()).flatten()[:6] / 500
    own = SWING_HZ * math.sqrt(1 - DAMPING**2)
    assert float(crossings.diff().mean()) == pytest.approx(0.5 / own, rel=0.05)
    assert after[-1].abs() < 0.05 * after.abs().max()


def test_a_swing_moves_loose_cloth_and_not_the_skin(body: Body):
    person = create_person(body, torch.zeros(body.shape_dirs.shape[2]))
    moves = move("turn", TIMES[:400:100], 1.0)
    pulled = Moves(
        moves.global_orient, moves.body_pose, moves.transl,
        torch.tensor([1.0, 0, 0]).double().expand(4, 24, 3),
    )  # fmt: skip
    for still, swung in zip(person.posed(moves), person.posed(pulled), strict=True):
        away = np.linalg.norm(still - swung, axis=1)
        assert away[person.drape.slack == 0].max() == 0
        assert 0.01 < away.max() < 1.5 * SAG
