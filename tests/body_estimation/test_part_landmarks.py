from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from skimage.data import astronaut

from deblur_avatar.body_estimation import part_landmarks
from deblur_avatar.body_estimation.part_landmarks import (
    BOX_PIXELS,
    FACE_ROWS,
    HAND_COUNT,
    detect_parts,
)

ROOTS = {0: (150.0, 120.0), 1: (70.5, 130.25)}  # of the fingers, pixels
REACH = 6.0  # pixels from them back to the wrist
HEAD = (110.0, 40.0)
SIZE = 240.0


def person(frames: int = 1) -> torch.Tensor:
    """Landmarks of a person 240 pixels tall, hands pointing down."""
    points = torch.zeros(frames, 33, 2)
    points[:] = torch.tensor(HEAD)
    points[:, [27, 28]] = torch.tensor([110.0, 280.0])
    for side in (0, 1):
        x, y = ROOTS[side]
        points[:, 13 + side] = torch.tensor([x, y - 40.0])
        points[:, 15 + side] = torch.tensor([x, y - REACH])
        points[:, 17 + side], points[:, 19 + side] = torch.tensor([[x - 4, y], [x + 4, y]])
    return points


def mark(x: float, y: float, z: float) -> SimpleNamespace:
    return SimpleNamespace(x=x, y=y, z=z)


class BrightestSpot:
    """Finds a hand or a face whose landmarks all lie at the brightest pixel of what it is shown."""

    def __init__(self, label: str, score: float = 0.9):
        self.label, self.score, self.shown = label, score, []

    def process(self, picture: np.ndarray) -> SimpleNamespace:
        self.shown.append(picture)
        bright = picture.sum(-1).astype(float)
        if bright.max() < 200:
            none = {"multi_hand_landmarks": None, "multi_face_landmarks": None}
            return SimpleNamespace(**none)
        rows, columns = np.nonzero(bright > 0.5 * bright.max())
        x, y = (columns.mean() + 0.5) / BOX_PIXELS, (rows.mean() + 0.5) / BOX_PIXELS
        # Spread about it by a tenth of the box in the picture, by 2 cm in space.
        around = [(np.cos(k), np.sin(k), np.cos(2 * k)) for k in range(468)]
        marks = [mark(x + 0.1 * a, y + 0.1 * b, 0.1 * c) for a, b, c in around]
        metres = [mark(0.02 * a, 0.02 * b, 0.01 * c) for a, b, c in around[:HAND_COUNT]]
        side = SimpleNamespace(label=self.label, score=self.score)
        return SimpleNamespace(
            multi_hand_landmarks=[SimpleNamespace(landmark=marks[:HAND_COUNT])],
            multi_hand_world_landmarks=[SimpleNamespace(landmark=metres)],
            multi_handedness=[SimpleNamespace(classification=[side])],
            multi_face_landmarks=[SimpleNamespace(landmark=marks)],
        )


@pytest.fixture
def looked(monkeypatch):
    """Detect with models of our own."""

    def detect(frames, points=None, label="Right", seen=None):
        hands, face = BrightestSpot(label), BrightestSpot(label)

        @contextmanager
        def models():
            yield hands, face

        monkeypatch.setattr(part_landmarks, "_models", models)
        points = person(len(frames)) if points is None else points
        seen = torch.ones(len(frames), 33) if seen is None else seen
        return detect_parts(frames, points, seen), hands, face

    return detect


def spotted(*spots: tuple[int, int]) -> torch.Tensor:
    """A black frame with white spots of 3 x 3 pixels."""
    frame = torch.zeros(1, 300, 220, 3, dtype=torch.uint8)
    for x, y in spots:
        frame[0, y - 1 : y + 2, x - 1 : x + 2] = 255
    return frame


def test_parts_are_told_in_pixels_of_the_frame(looked):
    """The centre of the pixel in column 155, row 118 is at (155.5, 118.5)."""
    parts, _, _ = looked(spotted((155, 118), (72, 131), (108, 44)))
    assert parts.hand_found.all()
    assert parts.face_found.all()
    circle = torch.tensor([(np.cos(k), np.sin(k)) for k in range(468)]).float()
    for side, spot in enumerate([(155.5, 118.5), (72.5, 131.5)]):
        middle = parts.hands[0, side, :, :2] - 0.1 * 0.22 * 240 * circle[:HAND_COUNT]
        assert middle.numpy() == pytest.approx(np.tile(spot, (HAND_COUNT, 1)), abs=0.3)
    middle = parts.face[0, :, :2] - 0.1 * 0.26 * 240 * circle[list(FACE_ROWS)]
    assert middle.numpy() == pytest.approx(np.tile((108.5, 44.5), (len(FACE_ROWS), 1)), abs=0.3)


def test_a_hand_is_as_deep_as_its_picture_is_wide(looked):
    """Depth of the model of metres in pixels: 1 cm where 2 cm are a tenth of the box."""
    parts, _, _ = looked(spotted((150, 120)))
    depth = parts.hands[0, 0, :, 2]
    wanted = 0.5 * 0.1 * 0.22 * 240 * torch.cos(2.0 * torch.arange(HAND_COUNT))
    assert (depth - depth.mean()).numpy() == pytest.approx(
        (wanted - wanted.mean()).numpy(), rel=0.02, abs=0.02
    )


def test_what_mediapipe_calls_right_is_a_left_hand(looked):
    """It takes pictures for mirrored ones."""
    right, _, _ = looked(spotted((150, 120)), label="Right")
    left, _, _ = looked(spotted((150, 120)), label="Left")
    assert right.left[0].tolist() == pytest.approx([0.9, 0.5])  # nothing at the other wrist
    assert left.left[0].tolist() == pytest.approx([0.1, 0.5])


def test_boxes_that_leave_the_frame_are_black_there(looked):
    points = person()
    points[:, [15, 17, 19]] = torch.tensor([219.0, 120.0])
    _, hands, _ = looked(torch.full((1, 300, 220, 3), 90, dtype=torch.uint8), points)
    assert hands.shown[0][:, : BOX_PIXELS // 2 - 8].min() == 90
    assert hands.shown[0][:, BOX_PIXELS // 2 + 12 :].max() == 0


def middle_of_box(looked, points: torch.Tensor, seen: torch.Tensor | None = None) -> float:
    """Where a spot at the roots of the left fingers lies in the left hand's box, from its middle.

    As a share of the box, down.
    """
    _, hands, _ = looked(spotted((150, 120)), points, seen=seen)
    rows, _ = np.nonzero(hands.shown[0].sum(-1) > 300)
    return float((rows.mean() + 0.5) / BOX_PIXELS - 0.5)


def test_boxes_lie_about_the_roots_of_the_fingers_and_grow_with_the_hand(looked):
    points = person()
    assert middle_of_box(looked, points) == pytest.approx(0.0, abs=0.02)
    points[:, [15]] -= torch.tensor([0.0, 44.0])  # a hand of 50 pixels: a box of 140
    _, hands, _ = looked(spotted((150, 120)), points)
    wide = np.ptp(np.nonzero(hands.shown[0].sum(-1) > 300)[1]) + 1
    assert wide == pytest.approx(3 * BOX_PIXELS / (2.8 * 50), abs=2)


def test_where_fingers_are_not_marked_the_forearm_points_to_them(looked):
    """COCO's landmarks end at the wrist; those that are not marked are at (0, 0)."""
    points, seen = person(), torch.ones(1, 33)
    points[:, 17:23], seen[:, 17:23] = 0.0, 0.0
    off = (120.5 - (120.0 - REACH + 0.4 * (40.0 - REACH))) / (0.22 * SIZE)
    assert middle_of_box(looked, points, seen) == pytest.approx(off, abs=0.02)
    seen[:, 13:15] = 0.0  # no elbow either: about the wrist
    off = (120.5 - (120.0 - REACH)) / (0.22 * SIZE)
    assert middle_of_box(looked, points, seen) == pytest.approx(off, abs=0.02)


def test_hands_and_heads_that_are_not_marked_are_not_looked_for(looked):
    points, seen = person(), torch.ones(1, 33)
    seen[:, [0, 7, 8, 16]] = 0.0
    points[:, [0, 7, 8, 16]] = 0.0
    parts, hands, face = looked(spotted((150, 120), (2, 2)), points, seen=seen)
    assert (len(hands.shown), len(face.shown)) == (1, 0)
    assert parts.hand_found.tolist() == [[True, False]]
    seen[:, 7], points[:, 7] = 1.0, torch.tensor(HEAD)  # one ear will do
    parts, _, face = looked(spotted((110, 40)), points, seen=seen)
    assert parts.face_found.tolist() == [True]


def test_nobody_and_small_people_are_not_looked_at(looked, caplog):
    frames = spotted((150, 120)).expand(2, -1, -1, -1)
    seen = torch.tensor([0.0, 1.0])[:, None].expand(2, 33)
    with caplog.at_level("INFO"):
        parts, hands, _ = looked(frames, seen=seen)
    assert parts.hand_found.tolist() == [[False, False], [True, False]]
    assert parts.hands[0].abs().max() == 0
    assert parts.sizes.tolist() == [0, SIZE]
    assert len(hands.shown) == 2
    assert "in 1 of 2 frames" in caplog.text
    parts, hands, _ = looked(frames, person(2) * 0.4)
    assert not parts.hand_found.any()
    assert hands.shown == []
    parts, _, _ = looked(frames, seen=torch.zeros(2, 33))
    assert not parts.face_found.any()
    assert parts.sizes.tolist() == [0, 0]


def test_a_person_is_as_large_lying_as_standing_and_one_wild_landmark_does_not_matter(looked):
    lying = person(9).flip(-1)
    lying[4, 30, 0] = 5000.0
    parts, _, _ = looked(spotted((5, 5)).expand(9, -1, -1, -1), lying)
    assert parts.sizes.tolist() == [SIZE] * 9


def test_mediapipe_finds_a_face_and_which_way_it_looks(capfd: pytest.CaptureFixture[str]):
    pytest.importorskip("mediapipe", reason="mediapipe is not installed")
    portrait = torch.from_numpy(np.ascontiguousarray(astronaut()))[None]
    points = torch.zeros(1, 33, 2)
    points[:] = torch.tensor([225.0, 500.0])
    points[:, [0, 7, 8]] = torch.tensor([225.0, 110.0])  # her head
    parts = detect_parts(
        torch.cat([portrait, torch.zeros_like(portrait)]),
        points.expand(2, -1, -1),
        torch.ones(2, 33),
    )
    assert "WARNING" not in capfd.readouterr().err  # its own, of which users can make nothing
    assert parts.face_found.tolist() == [True, False]
    face = dict(zip(FACE_ROWS, parts.face[0], strict=True))
    assert face[1][:2].tolist() == pytest.approx([224, 130], abs=10)  # the nose
    assert face[263][0] > face[1][0] > face[33][0]  # her left is on the right of the picture
    assert face[10][1] < face[1][1] < face[152][1]
    assert face[1][2] < min(face[234][2], face[454][2]) - 10  # the nose is nearer than the sides
    assert parts.face[1].abs().max() == 0
