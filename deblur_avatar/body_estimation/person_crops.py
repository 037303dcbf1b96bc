"""Person crops: each camera's pictures, cut to where the person goes over the clip, and scaled.

The body says where she goes. A wide skirt, long hair and what poses get wrong reach beyond it; of
the training camera mattes show them.
"""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import project
from deblur_avatar.imaging.resampling import Crop, crop_and_scale_intrinsics, crop_around

PERSON = 128  # matte, of 255
STRAY = 0.02  # share of frames whose mattes may reach beyond the crop: some hold another's corner
MATTE_MARGIN = 0.02  # around mattes, so that they do not touch the crop's rim


def person_crops(
    cameras: Cameras,
    body: Body,
    poses: Poses,
    margin: float,
    image_height: int,
    mattes: Mapping[int, UInt8[Tensor, "F H W"]],
) -> tuple[list[Crop], Cameras]:
    """A crop for each camera, and the cameras that see the crops scaled to `image_height`.

    Args:
        cameras: of the clip.
        body: who is in it.
        poses: of every frame; the crops hold all of them.
        margin: around the person, as a share of the box.
        image_height: pixels; frames no taller are kept whole.
        mattes: of the person, by camera; of cameras that are not in it the body alone counts.

    Raises:
        ArtifactError: if a camera never sees the body.
    """
    vertices = posed(body, poses).vertices
    crops, Ks, sizes = [], [], []
    for index, name in enumerate(cameras.names):
        width, height = cameras.sizes[index].tolist()
        crop = (0, 0, width, height)
        if height > image_height:
            pixels, _ = project(vertices, cameras.Ks[index], cameras.viewmats[index])
            boxes = torch.cat([pixels.amin(1), pixels.amax(1)], dim=-1)
            try:
                crop = crop_around(boxes, margin, (width, height))
                if index in mattes and (filled := _filled_box(mattes[index])) is not None:
                    crop = _both(crop, crop_around(filled, MATTE_MARGIN, (width, height)))
            except ValueError as error:
                raise ArtifactError(f"camera {name}: {error}; check the calibration") from error
        shrink = min(1.0, image_height / crop[3])
        size = (max(1, round(crop[2] * shrink)), max(1, round(crop[3] * shrink)))
        crops.append(crop)
        sizes.append(size)
        Ks.append(crop_and_scale_intrinsics(cameras.Ks[index], crop, size))
    return crops, replace(cameras, Ks=torch.stack(Ks), sizes=torch.tensor(sizes))


def _filled_box(mattes: UInt8[Tensor, "F H W"]) -> Float[Tensor, "1 4"] | None:
    """Left, top, right, bottom of nearly all frames' mattes; None where all are empty."""
    person = mattes >= PERSON
    shown = person[person.flatten(1).any(1)]
    if not len(shown):
        return None
    sides = []
    for across in (shown.any(1), shown.any(2)):  # columns, rows
        count = across.shape[1]
        low = across.byte().argmax(1).float()
        high = count - across.flip(1).byte().argmax(1).float()
        sides.append((torch.quantile(low, STRAY), torch.quantile(high, 1 - STRAY)))
    (left, right), (top, bottom) = sides
    return torch.stack([left, top, right, bottom])[None]


def _both(one: Crop, other: Crop) -> Crop:
    """The smallest crop that holds two."""
    left, top = min(one[0], other[0]), min(one[1], other[1])
    right = max(one[0] + one[2], other[0] + other[2])
    bottom = max(one[1] + one[3], other[1] + other[3])
    return left, top, right - left, bottom - top
