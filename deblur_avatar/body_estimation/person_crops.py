"""Person crops: each camera's pictures, cut to where the body goes over the clip, and scaled."""

from dataclasses import replace

import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import project
from deblur_avatar.imaging.resampling import Crop, crop_and_scale_intrinsics, crop_around


def person_crops(
    cameras: Cameras, body: Body, poses: Poses, margin: float, image_height: int
) -> tuple[list[Crop], Cameras]:
    """A crop for each camera, and the cameras that see the crops scaled to `image_height`.

    Args:
        cameras: of the clip.
        body: who is in it.
        poses: of every frame; the crops hold all of them.
        margin: around the person, as a share of the box.
        image_height: pixels; frames no taller are kept whole.

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
            except ValueError as error:
                raise ArtifactError(f"camera {name}: {error}; check the calibration") from error
        shrink = min(1.0, image_height / crop[3])
        size = (max(1, round(crop[2] * shrink)), max(1, round(crop[3] * shrink)))
        crops.append(crop)
        sizes.append(size)
        Ks.append(crop_and_scale_intrinsics(cameras.Ks[index], crop, size))
    return crops, replace(cameras, Ks=torch.stack(Ks), sizes=torch.tensor(sizes))
