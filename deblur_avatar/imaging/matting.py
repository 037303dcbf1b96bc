"""How a person is lifted off the background, onto black.

Conventions. A picture is the person's light plus (1 - alpha) times the background's light, where
alpha is the matte (coverage). `light` says in which space light adds up: `linear`, or sRGB values
(as averaged by the paper). Pictures and mattes are 8 bits; the camera stands still.
"""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.imaging.exposure import Light

BARE = 26  # matte, of 255: below it (10 %) a pixel is taken to show the background
ENOUGH = 3  # frames that must show a pixel's background for it to be trusted


def background_plate(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]
) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"]]:
    """Estimate what a still camera sees behind the person: the (lower) median of the bare frames.

    Returns:
        The plate; and 255 where it is known: where the person is in some frame, and at least
        `ENOUGH` frames are bare. Elsewhere the plate is 0.
    """
    bare = mattes < BARE
    wanted = (mattes > 0).any(0) & (bare.sum(0) >= ENOUGH)
    bare = bare[:, wanted]
    # Sorted behind all others, what is not bare does not move the median of the rest.
    values = torch.where(bare[..., None], frames[:, wanted], 255).sort(dim=0).values
    middle = ((bare.sum(0) - 1) // 2)[None, :, None].expand(1, -1, 3)
    plate = torch.zeros_like(frames[0])
    plate[wanted] = values.gather(0, middle)[0]
    return plate, wanted.to(torch.uint8) * 255


def lift_person(
    frames: UInt8[Tensor, "F H W 3"],
    mattes: UInt8[Tensor, "F H W"],
    plate: UInt8[Tensor, "H W 3"],
    known: UInt8[Tensor, "H W"],
    light: Light,
) -> UInt8[Tensor, "F H W 3"]:
    """Take the background's share away: pictures of the person on black.

    The rest is clamped to what coverage `alpha` can emit, [0, alpha]. Where the plate is not known
    the background is taken to have the pixel's own colour, which multiplies it by alpha.
    """
    pairs = zip(frames, mattes, strict=True)
    return torch.stack([_lift(frame, matte, plate, known, light) for frame, matte in pairs])


def _lift(
    frame: UInt8[Tensor, "H W 3"],
    matte: UInt8[Tensor, "H W"],
    plate: UInt8[Tensor, "H W 3"],
    known: UInt8[Tensor, "H W"],
    light: Light,
) -> UInt8[Tensor, "H W 3"]:
    alpha = (matte.float() / 255)[..., None]
    behind = torch.where((known > 0)[..., None], plate, frame)
    seen, hidden = _to_light(frame, light), _to_light(behind, light)
    person = (seen - (1 - alpha) * hidden).clamp(min=0).minimum(alpha)
    return _from_light(person, light)


def _to_light(codes: UInt8[Tensor, "H W 3"], light: Light) -> Float[Tensor, "H W 3"]:
    srgb = codes.float() / 255
    return srgb_to_linear(srgb) if light == "linear" else srgb


def _from_light(values: Float[Tensor, "H W 3"], light: Light) -> UInt8[Tensor, "H W 3"]:
    srgb = linear_to_srgb(values) if light == "linear" else values
    return (srgb * 255).round().clamp(0, 255).to(torch.uint8)
