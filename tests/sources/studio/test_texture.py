import numpy as np
import pytest

from deblur_avatar.artifacts.body import Body
from deblur_avatar.sources.studio.clothes import (
    PIECES,
    Clothed,
    clothe,
)
from deblur_avatar.sources.studio.texture import (
    _PAINTERS,
    CELLS,
    RED,
    WHITE,
    _write,
    paint,
)


@pytest.fixture(scope="module")
def clothed(body: Body) -> Clothed:
    return clothe(
        body.vertices.double().numpy(),
        body.joints.double().numpy(),
        body.lbs_weights.double().numpy(),
        body.faces.numpy(),
    )


@pytest.fixture(scope="module")
def albedo(clothed: Clothed) -> np.ndarray:
    return paint(clothed)


def test_every_cell_of_every_triangle_is_painted(clothed: Clothed, albedo: np.ndarray):
    assert albedo.shape == (len(clothed.surface.faces), CELLS, CELLS, 3)
    i, j = np.indices((CELLS, CELLS))
    assert (albedo[:, i + j < CELLS].sum(-1) > 0).all()
    assert (albedo[:, i + j >= CELLS] == 0).all()
    assert albedo.max() <= 1


def test_clothes_have_detail_and_pieces_differ(clothed: Clothed, albedo: np.ndarray):
    used = np.add.outer(np.arange(CELLS), np.arange(CELLS)) < CELLS
    means = []
    for index, piece in enumerate(PIECES):
        colours = albedo[clothed.pieces == index][:, used].reshape(-1, 3)
        means.append(colours.mean(0))
        if piece != "skin":
            assert colours.std(0).max() > 0.02, piece
    gaps = np.linalg.norm(np.subtract.outer(means, means).diagonal(axis1=1, axis2=3), axis=-1)
    assert gaps[~np.eye(len(PIECES), dtype=bool)].min() > 0.01


def test_the_back_bears_a_name_that_the_front_does_not(clothed: Clothed):
    x, y = np.meshgrid(np.linspace(-0.12, 0.12, 60), np.linspace(0.32, 0.38, 20))
    places = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.1)], 1)
    front, back = np.tile([0.0, 0.0, 1.0], (x.size, 1)), np.tile([0.0, 0.0, -1.0], (x.size, 1))
    shirt = _PAINTERS["shirt"]
    red = [
        (shirt(places * (1, 1, side[0, 2]), side, clothed.landmarks, 1.0) == RED).all(1).mean()
        for side in (front, back)
    ]
    assert red[0] == 0
    assert red[1] > 0.2


def test_letters_read_from_left_to_right():
    # "4" of 5 x 7 dots on a grid of half dots: its crossbar is the fifth row from the top.
    columns, rows = np.meshgrid(np.arange(5) + 0.5 - 2.5, np.arange(7) + 0.5)
    colours = np.zeros((35, 3))
    _write(colours, "4", np.ones(35, bool), columns.ravel(), rows.ravel(), 1.0)
    shown = (colours == RED).all(1).reshape(7, 5)[::-1]
    assert shown[4].all()
    assert shown[:, 3].all()  # the upright stands right of the middle
    assert shown.sum() == 14


def test_letters_have_a_white_edge_and_keep_to_their_place():
    x = np.linspace(-4, 4, 161)
    colours = np.zeros((161, 3))
    where = x < 0.9
    _write(colours, "4", where, x, np.full(161, 2.5), 1.0)  # along the crossbar
    white, red = (colours == WHITE).all(1), (colours == RED).all(1)
    assert white[np.abs(x + 2.7) < 0.1].all()
    assert red[np.abs(x + 2.3) < 0.1].all()
    assert not (white | red)[x > 0.9].any()
