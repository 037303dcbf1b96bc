import dataclasses

import pytest
import torch

from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks
from deblur_avatar.body_estimation.trimming import trimmed, without_background
from deblur_avatar.imaging.backgrounds import Background, BackgroundEstimator
from deblur_avatar.imaging.matting import Plate, no_plate

FRAMES, HEIGHT, WIDTH = 5, 120, 160
WALL, SHIRT, TROUSERS = 90, 200, 92
HIP, KNEE, ANKLE = 23, 25, 27


def standing(shift: int = 0) -> tuple[torch.Tensor, Landmarks]:
    """Somebody in trousers of the wall's colour, and a matte that spills to her left."""
    frames = torch.full((FRAMES, HEIGHT, WIDTH, 3), WALL, dtype=torch.uint8)
    left = 60 + shift
    frames[:, 20:60, left : left + 30] = SHIRT
    frames[:, 60:110, left : left + 30] = TROUSERS
    mattes = torch.zeros(FRAMES, HEIGHT, WIDTH, dtype=torch.uint8)
    mattes[:, 20:110, left - 40 : left + 30] = 255
    points = torch.zeros(FRAMES, COUNT, 2)
    points[:, :, 0] = left + 15.0
    points[:, :, 1] = 25.0
    for side in (0, 1):
        for mark, row in ((HIP, 62.0), (KNEE, 85.0), (ANKLE, 108.0)):
            points[:, mark + side] = torch.tensor([left + (9.0, 21.0)[side], row])
    found = torch.ones(FRAMES, dtype=torch.bool)
    return frames, Landmarks(found, points, torch.ones(FRAMES, COUNT), mattes)


def behind() -> Background:
    wall = torch.full((HEIGHT, WIDTH, 3), WALL, dtype=torch.uint8)
    plate = Plate(wall, torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    return Background("median", [plate] * FRAMES, plate, None)


def test_trousers_of_the_walls_colour_stay_where_landmarks_say_so():
    frames, person = standing()
    plain = trimmed(frames, person, behind(), by_limbs=False)
    assert plain.mattes[:, 63:107, 60:90].max() == 0
    kept = trimmed(frames, person, behind(), by_limbs=True)
    assert (kept.mattes[:, 65:100, 66:84] == 255).all()
    for one in (plain, kept):
        assert (one.mattes[:, 24:56, 62:88] == 255).all()
        assert one.mattes[:, 20:110, 20:45].max() == 0  # what spills is trimmed either way
    assert torch.equal(kept.points, person.points)


def test_landmarks_that_a_detector_does_not_know_make_nobody_larger():
    frames, person = standing()
    known = torch.zeros(COUNT, dtype=torch.bool)
    known[[0, 11, 12, *range(23, 29)]] = True
    few = dataclasses.replace(
        person,
        points=person.points * known[:, None], visibility=person.visibility * known,
    )  # fmt: skip
    kept = trimmed(frames, few, behind(), by_limbs=True)
    assert (kept.mattes[:, 65:100, 66:84] == 255).all()
    assert kept.mattes[:, 20:110, 20:45].max() == 0


@pytest.mark.parametrize("kind", ["none", "matte"])
def test_without_a_known_background_mattes_stay(kind: str):
    frames, person = standing()
    nowhere = no_plate(person.mattes[0])
    known = (None, None) if kind == "none" else ([nowhere] * FRAMES, nowhere)
    kept = trimmed(frames, person, Background(kind, *known, None), by_limbs=True)
    assert torch.equal(kept.mattes, person.mattes)


@pytest.mark.parametrize("by_limbs", [False, True])
def test_every_cameras_person_is_trimmed_before_its_own_background(
    monkeypatch: pytest.MonkeyPatch, by_limbs: bool
):
    films = [standing(), standing(shift=10)]
    asked = []

    def background(self: BackgroundEstimator, kind: str, mattes: torch.Tensor) -> Background:
        asked.append((kind, bool(mattes[0, 50, 21])))
        return behind()

    monkeypatch.setattr(BackgroundEstimator, "background", background)
    scenes = [BackgroundEstimator(frames) for frames, _ in films]
    frames = torch.stack([frames for frames, _ in films])
    people, kind = without_background(
        frames, 1, "auto", [person for _, person in films], scenes, by_limbs=by_limbs
    )
    assert kind == "median"
    assert asked == [("auto", False), ("median", True)]  # the training camera settles the kind
    for person, (frames, before) in zip(people, films, strict=True):
        wanted = trimmed(frames, before, behind(), by_limbs=by_limbs)
        assert torch.equal(person.mattes, wanted.mattes)
