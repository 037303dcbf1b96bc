from dataclasses import replace

import torch

from deblur_avatar.body_estimation.surface_samples import sample_evenly


def test_a_part_has_as_many_points_as_it_has_surface(body):
    samples = sample_evenly(body, 4000)
    corners = body.vertices[body.faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas, middles = normals.norm(dim=-1), corners.mean(1)
    high = float(body.vertices[:, 1].median())
    wanted = float(areas[middles[:, 1] > high].sum() / areas.sum())
    found = float((samples.points[:, 1] > high).float().mean())
    assert abs(found - wanted) < 0.01


def test_points_lie_on_triangles_and_move_with_them(body):
    samples = sample_evenly(body, 50)
    middles = body.vertices[body.faces].mean(1)
    nearest = (samples.points[:, None] - middles).norm(dim=-1).amin(1)
    assert nearest.max() < 1e-6
    torch.testing.assert_close(samples.lbs_weights.sum(1), torch.ones(50))
    shift = torch.tensor([1.0, 2.0, 3.0])
    moved = sample_evenly(replace(body, vertices=body.vertices + shift), 50)
    torch.testing.assert_close(moved.points, samples.points + shift, atol=1e-5, rtol=0)


def test_the_same_body_gives_the_same_points(body):
    first, second = sample_evenly(body, 20), sample_evenly(body, 20)
    assert torch.equal(first.points, second.points)
