"""Avatars that are volumes, drawn ray by ray: what their kinds share.

While it is fitted, a volume draws patches of a picture with gradients. Around them stands the same
picture from few rays and without: losses see whole pictures, and those that compare neighbouring
pixels do so across the patches' edges too. Otherwise every pixel has its ray.

Conventions. World coordinates, metres, but for the box that rays are cut to, which turns with the
root. The instants of an exposure are drawn at the same pixels, by different samples along each ray.
Q rays, S instants, J joints, P pixels.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import AvatarModel, FrameState, Rendering, TrainingStep
from deblur_avatar.avatars.pixel_patches import (
    DrawnPixels,
    RaysParams,
    draw_patches,
    patch_middles,
    weighed,
)
from deblur_avatar.geometry.cameras import Camera, pixel_rays, project
from deblur_avatar.geometry.skinning import invert_rigid, skin_points, transform_points
from deblur_avatar.imaging.exposure import mean_of_instants, over
from deblur_avatar.rendering.volume_rendering import Rays, box_depths

PIXEL_MIDDLE = 0.5
# Not a parameter: rays that are followed together, so that a large picture fits into memory.
RAYS_AT_ONCE = 2048

# Draws rays: their light and coverage.
Marched = tuple[Float[Tensor, "Q 3"], Float[Tensor, " Q"]]


@dataclass(frozen=True)
class VolumeState(FrameState):
    """What is known of one frame, and in fitting the step that it is drawn in."""

    middle: Float[Tensor, "J 4 4"]  # canonical to posed, without gradient
    step: TrainingStep | None


@dataclass(frozen=True)
class VolumeRendering(Rendering):
    """Renders of a volume, and what was known of the frame."""

    state: Any


class VolumeAvatar(AvatarModel):
    """A volume round the body; a kind says what light and coverage come along a ray."""

    beyond_a_rig: ClassVar[str] = (
        "which is a volume that networks fill, and no skeleton carries one"
    )
    lbs_weights: Tensor

    def __init__(
        self, params: Any, body: Body, betas: Tensor, frames: int, averaging_space: str
    ) -> None:
        super().__init__(params, body, betas, frames, averaging_space)
        self.register_buffer("lbs_weights", body.lbs_weights.to(betas), persistent=False)

    @abstractmethod
    def march(
        self,
        state: Any,
        transforms: Float[Tensor, "J 4 4"],
        rays: Rays,
        generator: torch.Generator | None,
    ) -> Marched:
        """Light, premultiplied, and coverage that come along rays at one instant, differentiably.

        Args:
            state: what `condition` gave.
            transforms: canonical to posed, at the instant.
            rays: which all meet the box.
            generator: draws samples along the rays; None for the same ones each time.
        """

    @abstractmethod
    def bounds(
        self, transforms: Float[Tensor, "J 4 4"]
    ) -> tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]]:
        """Lowest and highest corner of the box of all that can be seen, in the root's axes.

        Args:
            transforms: canonical to posed, in the root's axes too.
        """

    def render(
        self,
        state: Any,
        transforms: Float[Tensor, "S J 4 4"],
        camera: Camera,
        *,
        average: bool = False,
        background: Float[Tensor, " 3"] | None = None,
    ) -> VolumeRendering:
        """Follow rays through all instants."""
        drawn = self._draw(state, camera)
        return self._rendering(state, transforms, camera, drawn, average, background)

    def render_exposure(
        self,
        state: Any,
        transforms: Float[Tensor, "instants J 4 4"],
        camera: Camera,
        *,
        average: bool,
    ) -> tuple[VolumeRendering, VolumeRendering]:
        """The same, with the same patches in both."""
        drawn = self._draw(state, camera)
        return (
            self._rendering(state, transforms[:-1], camera, drawn, average),
            self._rendering(state, transforms[-1:], camera, drawn, False),
        )

    def body_pixels(
        self, transforms: Float[Tensor, "J 4 4"], camera: Camera
    ) -> Bool[Tensor, "H W"]:
        """Pixels that show a vertex of the body, as if it were of glass."""
        vertices = skin_points(self.canonical_vertices, self.lbs_weights, transforms)
        places, _ = project(  # those behind the camera are far outside of the picture
            vertices, camera.K, camera.viewmat
        )
        columns, rows = places.floor().long().unbind(1)
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        shown = torch.zeros(camera.height, camera.width, dtype=torch.bool, device=places.device)
        shown[rows[inside], columns[inside]] = True
        return shown

    def rays(
        self,
        transforms: Float[Tensor, "J 4 4"],
        camera: Camera,
        pixels: Int64[Tensor, "P 2"],
    ) -> tuple[Rays, Bool[Tensor, " P"]]:
        """Rays through pixels' middles, cut to the box, and which of them meet it.

        Args:
            transforms: canonical to posed; no gradient flows back from where samples are.
            camera: who looks.
            pixels: columns and rows.
        """
        origins, directions = pixel_rays(
            camera.K, camera.viewmat, pixels.to(camera.K) + PIXEL_MIDDLE
        )
        still = transforms.detach()
        root_from_world = invert_rigid(still[0])
        low, high = self.bounds(root_from_world @ still)
        turned = directions @ root_from_world[:3, :3].T
        to_root = root_from_world.expand(len(origins), 4, 4)
        near, far = box_depths(transform_points(to_root, origins), turned, low, high)
        return Rays(origins, directions, near, far), far > near

    def _draw(self, state: VolumeState, camera: Camera) -> DrawnPixels | None:
        """The patches of a step of fitting."""
        if state.step is None:
            return None
        params: RaysParams = state.step.fitting.rays
        with torch.no_grad():
            _, possible = self.rays(state.middle, camera, _pixels(camera))
            possible = possible.reshape(camera.height, camera.width)
            likely = self.body_pixels(state.middle, camera)
            middles = patch_middles(likely, possible, params.on_person)
        return draw_patches(middles, params.patches, params.size, state.step.generator)

    def _rendering(
        self, state: VolumeState, transforms: Tensor, camera: Camera, drawn: DrawnPixels | None,
        average: bool, background: Tensor | None = None,
    ) -> VolumeRendering:  # fmt: skip
        pictures = torch.stack([self._picture(state, one, camera, drawn) for one in transforms])
        if average:
            pictures = mean_of_instants(pictures)[None]
        image, alpha = pictures[..., :3], pictures[..., 3]
        if background is not None:
            pairs = zip(image, alpha, strict=True)
            image = torch.stack([over(*one, background.expand_as(one[0])) for one in pairs])
        return VolumeRendering(image, alpha, len(transforms), None, state)

    def _picture(
        self, state: VolumeState, transforms: Tensor, camera: Camera, drawn: DrawnPixels | None
    ) -> Float[Tensor, "H W 4"]:
        """Light and coverage of one instant's picture."""
        size = camera.height, camera.width
        if state.step is None or drawn is None:
            whole = self._pixels(state, transforms, camera, _pixels(camera), None)
            return whole.unflatten(0, size)
        few = camera.binned(1 / state.step.fitting.rays.coarse)
        with torch.no_grad():
            values = self._pixels(state, transforms, few, _pixels(few), None)
            planes = values.unflatten(0, (few.height, few.width)).permute(2, 0, 1)
            around = torch.nn.functional.interpolate(planes[None], size, mode="bilinear")[0]
        fine = self._pixels(state, transforms, camera, drawn.pixels, state.step.generator)
        columns, rows = drawn.pixels.unbind(1)
        return around.permute(1, 2, 0).index_put((rows, columns), weighed(fine, drawn.weights))

    def _pixels(
        self, state: VolumeState, transforms: Tensor, camera: Camera, pixels: Tensor,
        generator: torch.Generator | None,
    ) -> Float[Tensor, "P 4"]:  # fmt: skip
        """Light and coverage of pixels, nothing where rays pass by."""
        rays, met = self.rays(transforms, camera, pixels)
        values = transforms.new_zeros(len(pixels), 4)
        rays = rays.part(met)
        # Of no rays at all, too: a picture without anybody has gradients, all of them 0.
        parts = [
            self.march(state, transforms, rays.part(slice(first, first + RAYS_AT_ONCE)), generator)
            for first in range(0, max(len(rays), 1), RAYS_AT_ONCE)
        ]
        found = torch.cat([torch.cat([light, alpha[:, None]], 1) for light, alpha in parts])
        return values.index_put((met.nonzero()[:, 0],), found)


def _pixels(camera: Camera) -> Int64[Tensor, "P 2"]:
    """All pixels of a camera, row by row: columns and rows."""
    rows, columns = torch.meshgrid(
        torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
    )
    return torch.stack([columns, rows], dim=-1).reshape(-1, 2).to(camera.K.device)
