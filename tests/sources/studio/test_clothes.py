import numpy as np
import pytest

from deblur_avatar.artifacts.body import Body
from deblur_avatar.sources.studio.clothes import (
    PIECES,
    Clothed,
    Surface,
    _shell,
    clothe,
)
from deblur_avatar.sources.studio.garments import (
    GARMENTS,
    find_landmarks,
    rise,
)

SHIRT, HAIR = (next(g for g in GARMENTS if g.piece == name) for name in ("shirt", "hair"))


@pytest.fixture(scope="module")
def clothed(body: Body) -> Clothed:
    return clothe(
        body.vertices.double().numpy(),
        body.joints.double().numpy(),
        body.lbs_weights.double().numpy(),
        body.faces.numpy(),
    )


def vertices_of(clothed: Clothed, piece: str) -> np.ndarray:
    faces = clothed.surface.faces[clothed.pieces == PIECES.index(piece)]
    return clothed.surface.vertices[np.unique(faces)]


def test_every_piece_is_worn(clothed: Clothed):
    assert set(np.unique(clothed.pieces)) == set(range(len(PIECES)))


def test_skinning_weights_stay_weights(clothed: Clothed):
    weights = clothed.surface.lbs_weights
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(1), 1)


def test_clothes_lie_where_they_belong(clothed: Clothed):
    marks = clothed.landmarks
    shirt, shorts = vertices_of(clothed, "shirt"), vertices_of(clothed, "shorts")
    assert shirt[:, 1].min() > marks.of("left_hip")[1] - 0.05
    assert np.abs(shirt[:, 0]).max() < marks.of("left_elbow")[0]
    assert shorts[:, 1].min() > marks.of("left_knee")[1]
    assert shorts[:, 1].max() < marks.of("spine1")[1]
    assert vertices_of(clothed, "hair")[:, 1].min() > marks.of("neck")[1]
    assert vertices_of(clothed, "shoes")[:, 1].max() < marks.of("left_ankle")[1] + 0.02


@pytest.fixture(scope="module")
def tube(clothed: Clothed) -> Surface:
    """A trunk without arms: 12 cm thick, from under the hips to the chest."""
    sections, rows = 32, 40
    angle, height = np.meshgrid(
        2 * np.pi * np.arange(sections) / sections, np.linspace(-0.3, 0.3, rows)
    )
    outward = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1).reshape(-1, 3)
    index = np.arange(rows * sections).reshape(rows, sections)
    here, right = index, np.roll(index, -1, axis=1)
    quads = np.stack([here[:-1], right[:-1], right[1:], here[1:]], -1).reshape(-1, 4)
    return Surface(
        vertices=0.12 * outward + height.reshape(-1, 1) * (0, 1, 0),
        normals=outward,
        lbs_weights=np.eye(24)[np.full(len(outward), 3)],
        looseness=np.zeros(len(outward)),
        slack=np.zeros(len(outward)),
        faces=np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
    )


def test_a_hem_is_straight_across_the_bodys_triangles(clothed: Clothed, tube: Surface):
    shirt = _shell(SHIRT, tube, clothed.landmarks)
    hem = clothed.landmarks.of("pelvis")[1] - 0.045
    lowest = shirt.vertices[shirt.vertices[:, 1] < hem + 0.002]
    assert len(lowest) > 20
    np.testing.assert_allclose(lowest[:, 1], hem, atol=1e-6)


def test_cloth_keeps_its_distance_from_the_body_and_is_loosest_at_the_hem(
    clothed: Clothed, tube: Surface
):
    shirt = _shell(SHIRT, tube, clothed.landmarks)
    distance = np.hypot(shirt.vertices[:, 0], shirt.vertices[:, 2]) - 0.12
    assert distance.min() > SHIRT.tight - 0.002  # the tube has 32 corners
    hem = shirt.vertices[:, 1] < -0.04
    assert abs(distance[hem].mean() - SHIRT.loose) < 0.002
    np.testing.assert_allclose(shirt.slack[hem], SHIRT.loose - SHIRT.least, atol=1e-4)


def test_looseness_and_slack_are_of_cloth_alone(clothed: Clothed):
    surface = clothed.surface
    skin = np.unique(surface.faces[clothed.pieces == PIECES.index("skin")])
    assert surface.looseness[skin].max() == 0
    assert surface.slack[skin].max() == 0
    assert 0 <= surface.looseness.min() <= surface.looseness.max() <= 1
    assert surface.slack.min() >= 0
    assert surface.slack.max() > 0.01


def test_skin_deep_under_the_shirt_is_left_out(clothed: Clothed):
    skin = vertices_of(clothed, "skin")
    chest = (np.abs(skin[:, 0]) < 0.1) & (skin[:, 1] > 0.1) & (skin[:, 1] < 0.3)
    assert not chest.any()


def test_hands_grow_no_hair_however_the_head_is_placed(body: Body):
    marks = find_landmarks(body.vertices.numpy(), body.joints.numpy(), body.lbs_weights.numpy())
    crown = np.array([[0.0, marks.of("head")[1] + 0.9 * marks.head_size, 0.0]])
    on_head, on_hand = np.eye(24)[[15]], np.eye(24)[[22]]
    assert HAIR.covers(crown, on_head, marks)[0] > 0
    assert HAIR.covers(crown, on_hand, marks)[0] < 0


def test_rise_goes_from_nothing_to_all_either_way():
    values = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(rise(values, 0.0, 1.0), [0, 0, 0.5, 1, 1])
    np.testing.assert_allclose(rise(values, 1.0, 0.0), [1, 1, 0.5, 0, 0])
