import logging

import pytest
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.backgrounds import BackgroundEstimator
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.imaging.matting import background_plate
from deblur_avatar.imaging.plate_light import STEADY, even_plates, relit
from tests.imaging.moving_camera import filmed, turned

FRAMES = 16
HUNTING = 0.4 * torch.sin(torch.arange(FRAMES) / 3)[:, None] * torch.tensor([1.0, 0.9, 0.7])


def in_light(
    frames: UInt8[Tensor, "F H W 3"], stops: Float[Tensor, "F 3"]
) -> UInt8[Tensor, "F H W 3"]:
    light = srgb_to_linear(frames / 255) * 2 ** stops[:, None, None]
    return (linear_to_srgb(light) * 255).round().clamp(0, 255).to(torch.uint8)


def dimmed(frames: UInt8[Tensor, "F H W 3"]) -> UInt8[Tensor, "F H W 3"]:
    """So that more light still fits."""
    return (0.7 * frames + 15).to(torch.uint8)


def standing() -> tuple[Tensor, Tensor, Tensor]:
    """Of a camera that stands still: frames, mattes and what is behind."""
    frames, mattes, behind = filmed(FRAMES, camera=turned(FRAMES))
    return dimmed(frames), mattes, dimmed(behind)


def moving() -> tuple[Tensor, Tensor, Tensor]:
    frames, mattes, behind = filmed(FRAMES)
    return dimmed(frames), mattes, dimmed(behind)


@pytest.mark.parametrize(("film", "kind"), [(standing, "median"), (moving, "aligned")])
def test_a_background_is_as_bright_as_each_frame(film, kind, caplog: pytest.LogCaptureFixture):
    frames, mattes, behind = film()
    with caplog.at_level(logging.INFO):
        found = BackgroundEstimator(in_light(frames, HUNTING)).background("auto", mattes)
    assert found.kind == kind
    assert "each frame's background follows it" in caplog.text
    assert found.one is None
    true = in_light(behind, HUNTING)
    edges = (mattes > 12) & (mattes < 243)
    known = torch.stack([plate.known for plate in found.plates or []])
    pictures = torch.stack([plate.picture for plate in found.plates or []])
    assert float(known[edges].float().mean()) > 0.8
    apart = (pictures.float() - true.float()).abs().mean(-1)[edges & known]
    steady = BackgroundEstimator(frames).background("auto", mattes).plates or []
    alike = torch.stack([plate.picture for plate in steady]).float()
    told = edges & torch.stack([plate.known for plate in steady])
    least = (alike - behind.float()).abs().mean(-1)[told].mean()
    assert float(apart.mean()) < float(least) + 1.5  # codes, more than in light that stays


def test_light_that_stays_changes_nothing():
    frames, mattes, _ = standing()
    one = background_plate(frames, mattes)
    for stops in (0.0, 0.8 * STEADY):
        light = torch.full((FRAMES, 3), 0.0)
        light[FRAMES // 3] = stops
        found = BackgroundEstimator(in_light(frames, light)).background("auto", mattes)
        assert found.one is not None
        assert (found.one.picture.float() - one.picture.float()).abs().max() <= 1


def test_a_single_frame_in_other_light_has_a_plate_in_it():
    frames, mattes, behind = standing()
    light = torch.zeros(FRAMES, 3)
    light[5] = -1.0
    found = BackgroundEstimator(in_light(frames, light)).background("median", mattes)
    assert found.plates is not None
    plate = found.plates[5]
    apart = (plate.picture.float() - in_light(behind, light)[5].float()).abs()[plate.known]
    assert float(apart.mean()) < 1.5
    assert float(plate.known.float().mean()) > 0.7


def test_where_light_changes_in_a_part_alone_the_background_is_not_known():
    """A reflection, a sun beside which someone stands."""
    frames, mattes, _ = standing()
    light = torch.zeros(FRAMES, 3)
    light[:4] = 0.5
    changed = in_light(frames, light)
    left = slice(0, 40)
    changed[12, :, left] = (changed[12, :, left].int() + 60).clamp(max=255).to(torch.uint8)
    found = BackgroundEstimator(changed).background("median", mattes)
    assert found.plates is not None
    known = found.plates[12].known
    assert float(known[:, 4:36].float().mean()) < 0.1
    assert float(known[:, 100:].float().mean()) > 0.9


def test_a_sky_that_is_white_in_any_light_does_not_hide_the_change():
    frames, mattes, _ = standing()
    light = HUNTING.clone()
    lit = in_light(frames, light)
    lit[:, :, 90:] = torch.where(mattes[:, :, 90:, None] > 0, lit[:, :, 90:], 255)
    lit[:, :20] = 255
    found = BackgroundEstimator(lit).background("median", mattes)
    assert found.one is None
    bare = lit[9][30:110, :30].float()
    assert found.plates is not None
    apart = (found.plates[9].picture[30:110, :30].float() - bare).abs()
    assert float(apart[mattes[9][30:110, :30] == 0].mean()) < 1.5


@pytest.mark.parametrize("stops", [-1.5, -0.3, 0.0, 0.7])
def test_light_is_given_and_taken_in_linear_values(stops: float):
    grey = torch.arange(10, 120, dtype=torch.uint8)[None, :, None].expand(4, -1, 3)
    given = relit(grey, torch.tensor([stops, 0.0, -stops]))
    true = in_light(grey[None], torch.tensor([[stops, 0.0, -stops]]))[0]
    assert torch.equal(given, true)
    assert torch.equal(given[..., 1], grey[..., 1])
    black = torch.zeros(2, 3, 3, dtype=torch.uint8)
    assert torch.equal(relit(black, torch.tensor([2.0, 2.0, 2.0])), black)


def test_where_too_little_of_the_background_is_seen_its_light_is_not_told():
    frames, mattes, _ = standing()
    covered = torch.full_like(mattes, 255)
    asked = []

    def plates_of(seen: Tensor) -> list:
        asked.append(len(seen))
        return [background_plate(seen, mattes)] * len(seen)

    even = even_plates(in_light(frames, HUNTING), covered, plates_of)
    assert asked == [FRAMES]
    assert even.stops is None
    assert even.lit(3) is even.plates[0]


def test_lit_plates_in_a_row_are_those_of_each_frame():
    frames, mattes, _ = standing()
    found = BackgroundEstimator(in_light(frames, HUNTING)).background("median", mattes).plates
    assert found is not None
    assert len(found) == FRAMES
    for plate, one in zip(found[4:7], (found[4], found[5], found[6]), strict=True):
        assert torch.equal(plate.picture, one.picture)
        assert torch.equal(plate.known, one.known)
    assert len(list(found)) == FRAMES
