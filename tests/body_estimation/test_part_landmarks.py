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

WRIST = {0: (150.0, 120.0), 1: (70.5, 130.25)}  # pixels
HEAD = (110.0, 40.0)


def person(frames: int = 1) -> torch.Tensor:
    """Landmarks of a person 240 pixels tall."""
    points = torch.zeros(frames, 33, 2)
    points[:, [0, 7, 8]] = torch.tensor(HEAD)
    points[:, [27, 28]] = torch.tensor([110.0, 280.0])
    points[:, 1:7] = points[:, 9:15] = points[:, 23:27] = points[:, 29:] = torch.tensor(HEAD)
    for side in (0, 1):
        points[:, [15 + side, 17 + side, 19 + side, 21 + side]] = torch.tensor(WRIST[side])
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

    def detect(frames, points=None, label="Right", found=None):
        hands, face = BrightestSpot(label), BrightestSpot(label)

        @contextmanager
        def models():
            yield hands, face

        monkeypatch.setattr(part_landmarks, "_models", models)
        points = person(len(frames)) if points is None else points
        found = torch.ones(len(frames), dtype=torch.bool) if found is None else found
        return detect_parts(frames, points, found), hands, face

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


def test_nobody_and_small_people_are_not_looked_at(looked):
    frames = spotted((150, 120)).expand(2, -1, -1, -1)
    parts, hands, _ = looked(frames, found=torch.tensor([False, True]))
    assert parts.hand_found.tolist() == [[False, False], [True, False]]
    assert parts.hands[0].abs().max() == 0
    assert len(hands.shown) == 2
    parts, hands, _ = looked(frames, person(2) * 0.4)
    assert not parts.hand_found.any()
    assert hands.shown == []
    parts, _, _ = looked(frames, found=torch.zeros(2, dtype=torch.bool))
    assert not parts.face_found.any()


def test_mediapipe_finds_a_face_and_which_way_it_looks(capfd: pytest.CaptureFixture[str]):
    pytest.importorskip("mediapipe", reason="mediapipe is not installed")
    portrait = torch.from_numpy(np.ascontiguousarray(astronaut()))[None]
    points = torch.zeros(1, 33, 2)
    points[:] = torch.tensor([225.0, 500.0])
    points[:, [0, 7, 8]] = torch.tensor([225.0, 110.0])  # her head
    parts = detect_parts(
        torch.cat([portrait, torch.zeros_like(portrait)]),
        points.expand(2, -1, -1),
        torch.tensor([True, True]),
    )
    assert "WARNING" not in capfd.readouterr().err  # its own, of which users can make nothing
    assert parts.face_found.tolist() == [True, False]
    face = dict(zip(FACE_ROWS, parts.face[0], strict=True))
    assert face[1][:2].tolist() == pytest.approx([224, 130], abs=10)  # the nose
    assert face[263][0] > face[1][0] > face[33][0]  # her left is on the right of the picture
    assert face[10][1] < face[1][1] < face[152][1]
    assert face[1][2] < min(face[234][2], face[454][2]) - 10  # the nose is nearer than the sides
    assert parts.face[1].abs().max() == 0
