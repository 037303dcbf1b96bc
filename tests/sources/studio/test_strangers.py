import numpy as np
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.sources.studio.person import create_person
from deblur_avatar.sources.studio.strangers import PARTS, draw_person
from deblur_avatar.sources.studio.unfitted_body import UnfittedParams

UNFITTED = UnfittedParams(shape_mm=8.0, weight_rounds=2, swing=1.0, hair_mm=25.0)


def drawn(body, seed: int):
    return draw_person(body, 0.8, UNFITTED, torch.Generator().manual_seed(seed))


def test_the_same_seed_is_the_same_person_and_another_is_not(body):
    one, again, other = drawn(body, 1), drawn(body, 1), drawn(body, 2)
    assert np.array_equal(one.mesh.albedo, again.mesh.albedo)
    assert np.array_equal(one.drape.vertices, again.drape.vertices)
    assert torch.equal(one.betas, again.betas)
    assert not torch.equal(one.betas, other.betas)
    cells = min(len(one.mesh.albedo), len(other.mesh.albedo))  # clothes are cut to the shape
    assert np.abs(one.mesh.albedo[:cells] - other.mesh.albedo[:cells]).mean() > 0.02


def test_nothing_of_the_studio_s_colours_is_left(body):
    """Not a print, a stripe or a face: no colour that covers much of one covers much of other."""

    def often(mesh):
        codes = (mesh.albedo[mesh.albedo.any(-1)] * 40).round().astype(int)
        values, counts = np.unique(codes, axis=0, return_counts=True)
        return {tuple(value) for value in values[counts > 0.02 * len(codes)]}

    studio = often(create_person(body, torch.zeros(body.shape_dirs.shape[2])).mesh)
    one = drawn(body, 3).mesh
    assert len(studio) > 2
    assert not studio & often(one)
    assert one.albedo.min() >= 0
    assert one.albedo.max() <= 1


def test_every_joint_s_surface_belongs_to_one_part():
    for name in SMPL_JOINT_NAMES:
        assert sum(name.strip("_123").endswith(part) for part in PARTS) == 1, name
