import pytest
import torch

from deblur_avatar.avatars.avatar import canonical_vertices
from deblur_avatar.avatars.forward_skinning import ForwardSkinning, baked
from deblur_avatar.avatars.surface_search import (
    LAST_LENGTH,
    SamplesParams,
    met_surface,
    near_body,
    placed_samples,
    sample_lengths,
)
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.rendering.volume_rendering import Rays
from tests.randomness import seeded

SAMPLES = {"near": 5, "front": 4, "free": 8, "band_m": 0.05}
RADIUS = 0.12


@pytest.fixture
def samples():
    return parse(SamplesParams, SAMPLES, "samples")


@pytest.fixture(scope="module")
def moved():
    moved = torch.eye(4)
    moved[:3, :3] = axis_angle_to_matrix(torch.tensor([0.3, 1.0, -0.2]))
    moved[:3, 3] = torch.tensor([1.0, 2.0, 3.0])
    return moved


@pytest.fixture(scope="module")
def skinning(body, moved):
    """A body that is moved as a whole."""
    vertices = canonical_vertices(body, torch.zeros(2))
    grid = baked(lambda points: torch.full((len(points), 24), 1 / 24), vertices, 4)
    return ForwardSkinning(grid, moved.expand(24, 4, 4), vertices, body.lbs_weights)


@pytest.fixture(scope="module")
def middle(body):
    """Canonical, within the chest."""
    return body.joints[9] + torch.tensor([0.0, 0.08, 0.0])


def ball(middle):
    return lambda points: (points - middle).norm(dim=1) - RADIUS


def rays_past(middle, moved, offsets):
    """Rays along the canonical z axis that pass the middle at some distances."""
    origins = middle + torch.stack([offsets, 0 * offsets, 0 * offsets - 0.6], dim=1)
    directions = torch.tensor([0.0, 0.0, 1.0]).expand(len(offsets), 3)
    count = len(offsets)
    return Rays(
        origins @ moved[:3, :3].T + moved[:3, 3], directions @ moved[:3, :3].T,
        torch.zeros(count), torch.full((count,), 1.2),
    )  # fmt: skip


def test_rays_meet_a_ball_where_it_is(skinning, middle, moved):
    offsets = torch.linspace(0, 0.11, 12)
    surface = met_surface(rays_past(middle, moved, offsets), skinning, ball(middle))
    assert surface.met.all()
    wanted = 0.6 - (RADIUS**2 - offsets**2).sqrt()
    torch.testing.assert_close(surface.depths, wanted, atol=2e-3, rtol=0)


def test_a_ball_is_met_by_as_many_rays_as_its_disc_is_large(skinning, middle, moved):
    offsets = 0.3 * torch.rand(400, generator=seeded()) - 0.15
    surface = met_surface(rays_past(middle, moved, offsets), skinning, ball(middle))
    assert ((offsets.abs() < RADIUS) == surface.met).float().mean() > 0.98


def test_what_lies_beyond_the_ends_of_a_ray_is_not_met(skinning, middle, moved):
    rays = rays_past(middle, moved, torch.zeros(1))
    short = Rays(rays.origins, rays.directions, rays.near, torch.tensor([0.4]))
    assert not met_surface(short, skinning, ball(middle)).met.any()
    late = Rays(rays.origins, rays.directions, torch.tensor([0.53]), rays.far)  # from within
    assert not met_surface(late, skinning, ball(middle)).met.any()


def test_point_and_depth_are_found_in_few_steps(skinning, middle, moved, monkeypatch):
    monkeypatch.setattr("deblur_avatar.avatars.surface_search.ITERATIONS", 2)
    monkeypatch.setattr("deblur_avatar.avatars.surface_search.CLOSE", 0.05)
    monkeypatch.setattr("deblur_avatar.avatars.surface_search.STEPS", 6)
    offsets = torch.linspace(0, 0.06, 9)
    assert met_surface(rays_past(middle, moved, offsets), skinning, ball(middle)).met.all()


def test_no_rays_meet_nothing(skinning, middle, moved):
    none = rays_past(middle, moved, torch.zeros(0))
    assert len(met_surface(none, skinning, ball(middle)).depths) == 0
    assert len(near_body(none, skinning, 4)) == 0


def test_rays_that_pass_the_body_by_are_told(skinning, middle, moved):
    rays = rays_past(middle, moved, torch.tensor([0.0, 0.1, 3.0]))
    assert near_body(rays, skinning, 24).tolist() == [True, True, False]


def test_samples_are_few_in_front_and_most_around_the_surface(samples, middle, moved):
    rays = rays_past(middle, moved, torch.zeros(2))
    depths = placed_samples(rays, torch.tensor([0.5, 0.02]), samples, None)
    assert depths.shape == (2, 9)
    assert (depths.diff(dim=1) > -1e-6).all()
    assert (depths[0, :4] < 0.45).all()
    assert ((depths[0, 4:] - 0.5).abs() < 0.05).all()
    torch.testing.assert_close(depths[0, 6], torch.tensor(0.5))
    assert (depths[1] >= 0).all()  # nothing before the ray begins
    drawn = placed_samples(rays, torch.tensor([0.5, 0.02]), samples, seeded())
    assert not torch.equal(drawn, depths)


def test_a_sample_stands_for_its_ray_up_to_the_next():
    lengths = sample_lengths(torch.tensor([[1.0, 1.5, 1.75]]))
    assert lengths.tolist() == [[0.5, 0.25, LAST_LENGTH]]


@pytest.mark.parametrize("change", [{"near": 0}, {"front": 0}, {"free": 0}, {"band_m": 0.0}])
def test_samples_that_cannot_be_taken_are_refused(change):
    with pytest.raises(ConfigError, match=next(iter(change))):
        parse(SamplesParams, SAMPLES | change, "samples")
