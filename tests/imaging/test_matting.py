import numpy as np
import pytest
import torch

from deblur_avatar.imaging import matting
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.imaging.exposure import decode, encode, over
from deblur_avatar.imaging.matting import (
    Plate,
    background_plate,
    comparable_pixels,
    lift_person,
    no_plate,
    scenery,
    trim_mattes,
)

pytestmark = pytest.mark.portable

HEIGHT, WIDTH, FRAMES = 24, 40, 7
PERSON = torch.tensor([0.9, 0.3, 0.2])


def background() -> torch.Tensor:
    rows = torch.linspace(0.2, 0.8, HEIGHT)[:, None, None]
    columns = torch.linspace(0.0, 0.2, WIDTH)[:, None]
    return (rows + columns).expand(HEIGHT, WIDTH, 3).clone()


def codes(values: torch.Tensor) -> torch.Tensor:
    return (values * 255).round().to(torch.uint8)


def walk(coverage: float = 1.0, averaging_space: str = "srgb") -> tuple[torch.Tensor, torch.Tensor]:
    """A person 8 pixels wide walks 4 pixels a frame; frames and mattes."""
    frames, mattes = [], []
    for frame in range(FRAMES):
        alpha = torch.zeros(HEIGHT, WIDTH)
        alpha[6:18, 2 + 4 * frame : 10 + 4 * frame] = coverage
        share = alpha[..., None]
        if averaging_space == "linear":
            mixed = share * srgb_to_linear(PERSON) + (1 - share) * srgb_to_linear(background())
            frames.append(codes(linear_to_srgb(mixed)))
        else:
            frames.append(codes(share * PERSON + (1 - share) * background()))
        mattes.append(codes(alpha))
    return torch.stack(frames), torch.stack(mattes)


def test_the_plate_shows_what_the_person_hid():
    frames, mattes = walk()
    plate = background_plate(frames, mattes)
    assert plate.known.all()
    assert torch.equal(plate.picture, codes(background()))


@pytest.mark.parametrize("pixels", [1, 50, 2**21])
def test_the_plate_is_the_same_however_much_is_sorted_at_once(monkeypatch, pixels: int):
    frames, mattes = walk()
    noisy = frames + torch.randint(0, 9, frames.shape, generator=torch.Generator().manual_seed(0))
    noisy = noisy.clamp(max=255).to(torch.uint8)
    monkeypatch.setattr(matting, "AT_ONCE", pixels)
    plate = background_plate(noisy, mattes)
    for row, column in ((3, 2), (12, 9), (12, 20), (20, 33)):
        seen = noisy[mattes[:, row, column] < matting.BARE, row, column]
        if plate.known[row, column] and bool((mattes[:, row, column] > 0).any()):
            middle = seen.sort(dim=0).values[(len(seen) - 1) // 2]
            assert plate.picture[row, column].tolist() == middle.tolist()


def test_the_plate_is_a_median_so_that_a_passing_shadow_does_not_show():
    frames, mattes = walk()
    frames[0] //= 2
    plate = background_plate(frames, mattes)
    assert torch.equal(plate.picture[plate.known], codes(background())[plate.known])


def test_what_is_never_bare_is_not_known():
    frames, mattes = walk()
    mattes[:, 12, 20] = 255
    assert not background_plate(frames, mattes).known[12, 20]


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
@pytest.mark.parametrize("coverage", [1.0, 0.6])
def test_lifting_undoes_the_mixture_with_the_background(averaging_space: str, coverage: float):
    frames, mattes = walk(coverage, averaging_space)
    lifted = lift_person(
        frames, mattes, [background_plate(frames, mattes)] * len(frames), averaging_space
    )
    if averaging_space == "linear":
        alone = linear_to_srgb(coverage * srgb_to_linear(PERSON))
    else:
        alone = coverage * PERSON
    difference = lifted[mattes > 0].float() - 255 * alone
    assert difference.abs().max() <= 3
    assert lifted[mattes == 0].max() == 0


def test_where_the_background_is_unknown_the_picture_is_multiplied_by_the_matte():
    frames, mattes = walk(0.5)
    unknown = Plate(torch.zeros_like(frames[0]), torch.zeros(HEIGHT, WIDTH, dtype=torch.bool))
    lifted = lift_person(frames, mattes, [unknown] * len(frames), "srgb")
    expected = frames.float() * (mattes.float() / 255)[..., None]
    assert (lifted.float() - expected).abs().max() <= 0.51


def test_a_person_emits_no_more_than_her_coverage():
    frames, mattes = walk(0.4)
    plate = background_plate(frames, mattes)
    brightened = frames.clamp(max=200) + 55
    lifted = lift_person(brightened, mattes, [plate] * len(frames), "srgb")
    assert (lifted <= mattes[..., None]).all()


def test_clothes_of_the_backgrounds_colour_stay():
    frames, mattes = walk()
    plate = background_plate(frames, mattes)
    hole = frames.clone()
    hole[3, 10:14, 16:20] = plate.picture[10:14, 16:20]
    trimmed = trim_mattes(hole, mattes, [plate] * len(frames))
    assert (trimmed[3, 10:14, 16:20] == 255).all()


def test_where_the_plate_looks_like_the_person_nothing_is_trimmed():
    frames, mattes = walk()
    plate = background_plate(frames, mattes)
    hidden = frames.clone()
    hidden[:, 12:18] = plate.picture[12:18]  # her legs have the background's colours
    asked = []

    def untold(index: int, plate: Plate) -> np.ndarray:
        asked.append(index)
        return np.full((HEIGHT, WIDTH), index == 3)

    plates = [plate] * len(frames)
    assert trim_mattes(hidden, mattes, plates)[:, 14:18].max() == 0
    kept = trim_mattes(hidden, mattes, plates, untold)
    assert torch.equal(kept[3], mattes[3])
    assert kept[[2, 4], 14:18].max() == 0
    assert sorted(asked) == list(range(FRAMES))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_mattes_are_the_same_however_many_frames_are_trimmed_at_once(monkeypatch, count: int):
    frames, mattes = walk()
    plate = background_plate(frames, mattes)
    plates = [Plate(plate.picture.roll(index, 0), plate.known) for index in range(FRAMES)]
    shown = torch.where(mattes[..., None] > 0, frames, torch.stack([one.picture for one in plates]))
    spilled = torch.maximum(mattes, mattes.roll(6, dims=2))

    def untold(index: int, plate: Plate) -> np.ndarray:
        return np.arange(WIDTH)[None] == 13 + 4 * index + np.zeros((HEIGHT, 1), int)

    wanted = trim_mattes(shown, spilled, plates, untold)
    assert not torch.equal(wanted, trim_mattes(shown, spilled, plates))
    assert not torch.equal(wanted, spilled)
    monkeypatch.setattr(matting, "FRAMES_AT_ONCE", count)
    assert torch.equal(trim_mattes(shown, spilled, plates, untold), wanted)


def test_nothing_is_trimmed_where_the_background_is_unknown():
    frames, mattes = walk()
    spilled = mattes.clone()
    spilled[3] = 255
    unknown = Plate(frames[0], torch.zeros(HEIGHT, WIDTH, dtype=torch.bool))
    assert torch.equal(trim_mattes(frames, spilled, [unknown] * len(frames)), spilled)


def test_colours_count_inside_and_outside_but_not_in_an_unknown_edge():
    mattes = torch.zeros(1, 200, 100, dtype=torch.uint8)
    mattes[0, 50:150, 30:70] = 255
    mattes[0, 50:150, 28:30] = 100
    nowhere = torch.zeros(1, 200, 100, dtype=torch.bool)
    unknown = comparable_pixels(mattes, nowhere)[0]
    assert unknown[100, 50] == 255
    assert unknown[100, 10] == 255
    assert unknown[100, 28:31].max() == 0
    assert comparable_pixels(mattes, ~nowhere).min() == 255


def walk_far() -> tuple[torch.Tensor, torch.Tensor, Plate]:
    """The walk in a picture ten times as large, in which "near" is some pixels."""
    frames, mattes = (images.repeat_interleave(10, 1).repeat_interleave(10, 2) for images in walk())
    return frames, mattes, background_plate(frames, mattes)


def test_frames_before_plates_are_as_filmed_near_the_person_and_the_plate_elsewhere():
    frames, mattes, plate = walk_far()
    littered = frames.clone()
    littered[:, 0, 0] = 255  # a passer-by's hat
    beside = int(torch.nonzero(mattes[2, 100]).min()) - 2
    littered[2, 100, beside] = 7  # the edge of a sleeve that the segmenter overlooked
    shown = scenery(littered, mattes, plate.picture[None], plate.known[None])
    assert torch.equal(shown.frames[:, 0, 0], plate.picture[0, 0].expand(FRAMES, -1))
    assert (shown.frames[2, 100, beside] == 7).all()
    assert torch.equal(shown.frames[mattes > 0], frames[mattes > 0])
    assert shown.comparable.min() == 255


def test_before_a_plate_with_a_hole_the_persons_edge_is_not_compared_but_her_inside_is():
    frames, mattes, plate = walk_far()
    hole = torch.zeros_like(plate.known)
    shown = scenery(frames, mattes, torch.zeros_like(plate.picture)[None], hole[None])
    inside = int(torch.nonzero(mattes[2, 100]).min()) + 20
    assert shown.comparable[2, 100, inside] == 255
    assert torch.equal(shown.frames[2, 100, inside], frames[2, 100, inside])
    assert shown.comparable[2, 100, inside - 20] == 0
    for beside in (inside - 23, 0):  # near her, too, nothing is left for an avatar to explain
        assert shown.comparable[2, 100, beside] == 255
        assert shown.frames[2, 100, beside].max() == 0


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
def test_a_person_over_the_plate_is_the_frame_whatever_the_matte_says(averaging_space: str):
    frames, mattes = walk(0.6, averaging_space)
    plate = background_plate(frames, mattes)
    wrong = torch.where(mattes > 0, 255, 0).to(torch.uint8)  # a segmenter is sure of blurred limbs
    shown = scenery(frames, wrong, plate.picture[None], plate.known[None]).frames.float() / 255
    light = decode(PERSON, averaging_space)
    for frame, matte in zip(shown, mattes, strict=True):
        alpha = matte.float() / 255
        person = alpha[..., None] * light
        behind = decode(plate.picture.float() / 255, averaging_space)
        made = encode(over(person, alpha, behind), averaging_space)
        torch.testing.assert_close(made, frame, atol=0.012, rtol=0)


def test_without_a_plate_a_pixel_is_what_its_matte_says():
    frames = torch.full((1, 8, 8, 3), 200, dtype=torch.uint8)
    mattes = torch.tensor([0, 51, 255, 255] * 2, dtype=torch.uint8).expand(1, 8, 8).contiguous()
    lifted = lift_person(frames, mattes, [no_plate(matte) for matte in mattes], "srgb")
    assert lifted[0, 0, :, 0].tolist() == [0, 40, 200, 200] * 2
