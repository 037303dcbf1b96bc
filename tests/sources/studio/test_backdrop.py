import numpy as np
import pytest

from deblur_avatar.sources.studio.backdrop import FACADE, Plane, draw_backdrop, street

K = np.array([[300.0, 0, 48], [0, 300, 32], [0, 0, 1]])
SIZE = (96, 64)


def viewmat(x: float = 0.0, z: float = 4.0) -> np.ndarray:
    """A camera on +Z that looks along -Z from 1 m above the floor."""
    world = np.diag([1.0, -1.0, -1.0, 1.0])
    world[:3, 3] = -world[:3, :3] @ (x, 1.0, z)
    return world


def card(z: float, side: float, red: float) -> Plane:
    """A square about the camera's axis."""
    texture = np.zeros((50, 50, 4), np.float32)
    texture[..., 0], texture[..., 3] = red, 1
    step = side / 50
    corner = [-side / 2, 1 + side / 2, z]
    return Plane(texture, np.array([[step, 0, 0], [0, -step, 0], corner]).T)


def test_a_plane_is_as_large_and_where_a_pinhole_sees_it():
    seen = draw_backdrop([card(-2.0, 0.6, 0.5)], K, viewmat(), SIZE)[..., 0]
    side = 300 * 0.6 / 6
    assert seen.sum() / 0.5 == pytest.approx(side**2, rel=0.03)
    rows, columns = np.nonzero(seen > 0.25)
    assert columns.mean() + 0.5 == pytest.approx(48, abs=0.3)
    assert rows.mean() + 0.5 == pytest.approx(32, abs=0.3)


def test_what_is_nearer_hides_what_is_farther_and_moves_more():
    planes = [card(-6.0, 1.0, 0.2), card(0.0, 0.2, 0.8)]
    before = draw_backdrop(planes, K, viewmat(), SIZE)[..., 0]
    assert before[32, 48] == pytest.approx(0.8)
    after = draw_backdrop(planes, K, viewmat(x=0.2), SIZE)[..., 0]
    near = np.nonzero(after > 0.5)[1].mean() - np.nonzero(before > 0.5)[1].mean()
    far = np.nonzero((after > 0.1) & (after < 0.5))[1].max()
    far -= np.nonzero((before > 0.1) & (before < 0.5))[1].max()
    assert near == pytest.approx(-300 * 0.2 / 4, abs=0.6)
    assert far == pytest.approx(-300 * 0.2 / 10, abs=1.1)


def test_a_street_fills_the_picture_with_texture_at_several_depths():
    planes = street(np.random.default_rng(0))
    picture = draw_backdrop(planes, K, viewmat(), SIZE)
    assert picture.min() > 0
    assert picture.max() <= 1.001
    assert np.abs(np.diff(picture, axis=1)).mean() > 0.01
    depths = {float(plane.world_from_texture[2, 2]) for plane in planes}
    assert len(depths) >= 6
    assert min(depths) < FACADE < max(depths)


def test_the_same_seed_puts_up_the_same_street():
    first, again, other = (street(np.random.default_rng(seed)) for seed in (1, 1, 2))
    pairs = zip(first, again, strict=True)
    assert all(np.array_equal(a.texture, b.texture) for a, b in pairs)
    assert not np.array_equal(first[1].texture, other[1].texture)
