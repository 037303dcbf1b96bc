import pytest
import torch

from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.imaging.matting import (
    Plate,
    background_plate,
    comparable_pixels,
    lift_person,
    no_plate,
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
    assert torch.equal(plate.known, (mattes > 0).any(0))
    assert torch.equal(plate.picture[plate.known], codes(background())[plate.known])


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
    unknown = comparable_pixels(mattes, [no_plate(matte) for matte in mattes])[0]
    assert unknown[100, 50] == 255
    assert unknown[100, 10] == 255
    assert unknown[100, 28:31].max() == 0
    known = no_plate(mattes[0])._replace(known=torch.ones(200, 100, dtype=torch.bool))
    assert comparable_pixels(mattes, [known]).min() == 255


def test_without_a_plate_a_pixel_is_what_its_matte_says():
    frames = torch.full((1, 8, 8, 3), 200, dtype=torch.uint8)
    mattes = torch.tensor([0, 51, 255, 255] * 2, dtype=torch.uint8).expand(1, 8, 8).contiguous()
    lifted = lift_person(frames, mattes, [no_plate(matte) for matte in mattes], "srgb")
    assert lifted[0, 0, :, 0].tolist() == [0, 40, 200, 200] * 2
