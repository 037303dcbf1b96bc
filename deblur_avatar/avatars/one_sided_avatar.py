"""Plain avatars of a person whom one camera sees from few sides.

Colours. Likeness of neighbours (`plain_avatar.py`) carries colours to the side that is not seen
only as far as a fit has steps for: its penalty is absolute, so that a patch which nothing has
coloured moves at its edge alone, and what is far from that keeps the grey it began with. And at the
edge of what the camera sees lie Gaussians that a few pixels show, half coloured, half the
background's. So once the avatar is fitted, Gaussians whose light no frame shows take the colour
that is well seen at the same place along the same limb (`limb_bands.py`).

Once the avatar is warm, whatever shows only a little takes it, too, and is fitted on from there:
from the grey that Gaussians begin with, a fit takes it only part of the way to its colour; from
that of its limb it has not far to go.

Where limbs of both sides show too little, the penalty is brought to its minimum: total variation
inpainting (Chan and Shen, "Nontexture inpainting by curvature-driven diffusions", JVCIR 2001) on
the graph of nearest neighbours, by reweighted least squares (Daubechies et al., CPAM 2010). It ends
where a shirt ends, which a mean would not.

What a frame shows. Fronts let a hundredth of the light behind them through, and from a hundred
pixels a back that nobody sees gathers a pixel's worth. So a frame counts for what turns away where
at least a twentieth of its own light arrives. A colour that goes on is one of a surface that faced
the camera: what stands out beside a silhouette has the colour of its edge.

Heights. Along the camera's line of sight a Gaussian may stand anywhere and be as thick as it likes,
and where poses are a little off it makes up for them by reaching in front of the body or behind it,
which another side sees as fluff. So none reaches farther off than clothes do, unless pictures ask
for it.

Opacity. Nothing in one side's pictures tells an opaque front from one through which a tenth of the
light comes from the back, and a fit of many small Gaussians ends there. Then backs are coloured by
what fronts lack, and from another side both are wrong. So a surface is held to be opaque: from any
side, what faces it shows, and what turns away does not.

Coverage. Beside the top of a head the camera's pixels take light away, and none gives it back: the
crown stays open. So a head is closed nearer to its silhouette than the rest of a body.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from pydantic import model_validator
from scipy.sparse import csr_matrix, diags_array
from scipy.sparse.linalg import splu
from torch import Tensor
from torch.nn.functional import normalize

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import Regularisers, TrainingStep
from deblur_avatar.avatars.closure import open_share, unmoved
from deblur_avatar.avatars.gaussians import neighbour_indices
from deblur_avatar.avatars.limb_bands import LimbPlaces, band_colors, limb_places
from deblur_avatar.avatars.params import AvatarParams, FittingParams
from deblur_avatar.avatars.plain_avatar import (
    COLORS,
    HEIGHT,
    LOOKS_EVERY,
    PlainAvatar,
    PlainFitting,
    SmoothnessParams,
)
from deblur_avatar.avatars.regularisers import excess_height
from deblur_avatar.avatars.splats import SplatRendering, SplatState
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.config.section import NonNegative, Positive
from deblur_avatar.geometry.cameras import Camera, camera_centres
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import blend_transforms, invert_rigid, transform_points
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.rendering.conventions import eps2d_of
from deblur_avatar.rendering.covariance_factors import covariance_factors
from deblur_avatar.rendering.covariances import whole_matrices
from deblur_avatar.rendering.reference import project

LOOKS = 48  # frames at most, spread over the clip
PASSES = 0.05  # share of its own light that arrives where a frame shows what turns away
FACES = 0.3  # cosine between a surface and the camera, from where on it faces that
NEIGHBOURS = 8
FAR = 1e-4  # weight of a neighbour however far it is, so that no Gaussian is alone
ANEW = 0.3  # of the pixels that make sure: what shows fewer while fitting goes on begins anew
SURE_SHARE = 0.2  # of all Gaussians show enough at least: of somebody small all show few pixels
OWN = 1e-9  # of a Gaussian's own colour, where all that it is connected with is unseen
ROUNDS = 12  # of reweighting; the first one's colours are harmonic
ALIKE = 0.01  # colours this near to each other count as one
DARKEST = 1e-3  # colours stay this far from black and white, whose logits are infinite
CLOTHES = 0.03  # metres that a Gaussian may reach off the body, to either side
# From what share of the depth on nothing may be seen through: a head is no thinner than the fitted
# body's, as a limb may be.
CLOSED_NEARER = {"head": 0.2}
OPAQUE = 0.95  # share of the light inside a silhouette that comes from what faces the camera
REACH = 2.0  # standard deviations across the surface that it reaches


class OneSidedParams(AvatarParams):
    """Nothing to choose."""

    kind: Literal["one_sided"]


class OneSidedSmoothness(SmoothnessParams):
    """A plain avatar's, and weights of heights themselves and of what shines through."""

    near_body: NonNegative  # no Gaussian reaches farther off the body than clothes do
    opaque: NonNegative  # from any side, only what faces it shows; whatever is seen


class OneSidedFitting(PlainFitting):
    """As a plain one; and of how many pixels each Gaussian shows in the frame of most."""

    least_pixels: Positive  # with fewer its colour is unknown
    sure_pixels: Positive  # of frames that it faces: with as many it goes on; of small people fewer
    regularisers: OneSidedSmoothness

    def weights(self, step: TrainingStep, occluded_fraction: float) -> Mapping[str, float]:
        """A plain avatar's; a front is opaque whether the back is seen or not."""
        plain = super().weights(step, occluded_fraction)
        return {**plain, "opaque": self.regularisers.opaque}

    @model_validator(mode="after")
    def _sure_is_known(self) -> "OneSidedFitting":
        least, sure = self.least_pixels, self.sure_pixels
        if sure < least:
            raise ValueError(f"sure_pixels: {sure} is less than least_pixels, {least}")
        return self


class Shown(NamedTuple):
    """Pixels that Gaussians colour, in the frame of most."""

    pixels: Float[np.ndarray, " N"]  # of frames that they face or to which enough light arrives
    facing: Float[np.ndarray, " N"]  # of frames for which both are so


class OneSidedAvatar(PlainAvatar):
    """A plain avatar that stays near its body, and whose colours go on where no frame shows any."""

    kind = "one_sided"
    Params: ClassVar[type[AvatarParams]] = OneSidedParams
    Fitting: ClassVar[type[FittingParams]] = OneSidedFitting
    closed_nearer: ClassVar[Mapping[str, float]] = CLOSED_NEARER

    def regularisers(self, rendering: SplatRendering, step: TrainingStep) -> Regularisers:
        """A plain avatar's; and Gaussians stay near the body, and hide what is behind them."""

        def near_body() -> Tensor:
            gaussians, surface = self.gaussians, self._surface()
            factors = covariance_factors(gaussians.quats, gaussians.scales)
            reach = REACH * (surface.normals[:, None] @ factors)[:, 0].norm(dim=1)
            return excess_height(surface.heights(gaussians.means), reach, CLOTHES) / HEIGHT

        terms = {**super().regularisers(rendering, step), "near_body": near_body}
        look, between = divmod(step.iteration, LOOKS_EVERY)
        return terms if between else terms | {"opaque": lambda: self._shines_through(look, step)}

    def _open_share(self, look: int, step: TrainingStep) -> Tensor:
        """How much light passes between what faces one side, which alone closes the surface."""
        return LOOKS_EVERY * open_share(self._light(look, self._faced(look, step)))

    def _shines_through(self, look: int, step: TrainingStep) -> Tensor:
        """How much light comes from what turns away, of the canonical avatar seen from one side.

        By opacities alone: a front that grew wide instead would be blurred.
        """
        state = self._faced(look, step)
        still = replace(
            state, means=state.means.detach(), covariance_factors=state.covariance_factors.detach()
        )
        return LOOKS_EVERY * (OPAQUE - self._light(look, still)).relu().mean()

    def _faced(self, look: int, step: TrainingStep) -> SplatState:
        """The canonical avatar, white where it faces the camera of a look and black elsewhere."""
        viewmat, still = self._view(look).camera.viewmat, unmoved(self)[0]
        state = self.condition(still[:, :3, :3], 0, still, viewmat, step)
        towards = camera_centres(viewmat) - state.means.detach()
        faces = (self._surface().normals * towards).sum(1) > 0
        return replace(state, colors=faces[:, None].expand(-1, COLORS).to(towards))

    def _light(self, look: int, state: SplatState) -> Float[Tensor, " inside"]:
        """Of the pixels of a look that lie well inside the body."""
        view = self._view(look)
        return self.render(state, unmoved(self), view.camera).image[0, ..., 0][view.inside]

    def inpaint(
        self,
        fitting: OneSidedFitting,
        observations: Observations,
        centre: Poses,
        *,
        finished: bool,
    ) -> None:
        """Fill in the colours of Gaussians that show too little of themselves in every frame.

        While fitting goes on, those that show some, too, but not enough of a side that faces the
        camera.
        """
        shown, places = self.shown_pixels(observations, centre), self._places()
        few = np.quantile(shown.pixels, 1 - SURE_SHARE)  # of somebody small: all show few
        enough = max(min(fitting.sure_pixels, few), fitting.least_pixels)
        seen = np.where(places.behind, shown.facing, shown.pixels)
        sure = shown.facing >= enough
        begins_anew = max(ANEW * enough, fitting.least_pixels)
        unknown = seen < fitting.least_pixels if finished else shown.facing < begins_anew
        if not unknown.any() or not sure.any():
            return
        features = self.gaussians.features
        colors = features[:, :COLORS].detach().sigmoid().cpu().double().numpy()
        bands = band_colors(colors, np.where(sure, shown.facing, 0), places)
        banded = unknown & np.isfinite(bands).all(1)
        colors[banded] = bands[banded]
        if (unknown & ~banded).any():
            means = self.gaussians.means.detach().cpu().double().numpy()
            colors[unknown] = inpainted(means, colors, sure | banded)[unknown]
        logits = torch.from_numpy(colors[unknown]).clamp(DARKEST, 1 - DARKEST).logit()
        with torch.no_grad():
            at = torch.from_numpy(unknown).to(features.device)
            features[at, :COLORS] = logits.to(features)

    def shown_pixels(self, observations: Observations, centre: Poses) -> Shown:
        """How many of the person's pixels each Gaussian colours.

        Pixels count by their mattes, and not where colours are not compared.

        Args:
            observations: of whose training frames at most `LOOKS` are rendered.
            centre: poses at the middle of each frame.
        """
        camera = observations.camera
        most = torch.zeros(2, len(self.gaussians))
        for position in evenly_spaced(observations.shown, LOOKS):
            pose = centre.at([position])
            rotations = axis_angle_to_matrix(pose.axis_angle)
            matte = (observations.mattes[position].float() / 255)[..., None].expand(-1, -1, 3)
            told = observations.comparable_part(matte, position)
            most = torch.maximum(most, self._shown(rotations, pose.transl, camera, told).cpu())
        return Shown(*most.numpy())

    def _shown(
        self,
        rotations: Float[Tensor, "1 J 3 3"],
        transl: Float[Tensor, "1 3"],
        camera: Camera,
        told: Float[Tensor, "H W 3"],
    ) -> Float[Tensor, "2 N"]:
        """The same in one frame.

        Args:
            rotations: of joints relative to their parents.
            transl: of the body.
            camera: of the frame.
            told: how far each pixel tells a colour, in [0, 1].

        Returns:
            As the fields of `Shown`.
        """
        device, gaussians, camera = self.betas.device, self.gaussians, camera.to(self.betas)
        with torch.no_grad():
            transforms = self.transforms(rotations, transl)
            state = self.condition(rotations[0].to(device), 0, transforms[0], camera.viewmat)
        # Its colour's share of the picture's sum is what a Gaussian shows.
        white = torch.ones_like(state.colors, requires_grad=True)
        rendering = self.render(replace(state, colors=white), transforms, camera)
        (pixels,) = torch.autograd.grad((rendering.image[0] * told.to(device)).sum(), white)
        with torch.no_grad():
            means, covars = rendering.means, whole_matrices(rendering.covars)
            unobstructed = gaussians.opacities * project(
                means, covars, gaussians.opacities, camera.viewmat, camera.K, camera.width,
                camera.height, eps2d_of(camera.binning),
            ).areas[0]  # fmt: skip
            turns = blend_transforms(state.lbs_weights, transforms[0])[:, :3, :3]
            normals = normalize((turns @ self._surface().normals[..., None])[..., 0])
            towards = normalize(camera_centres(camera.viewmat) - means[0])
        passes = pixels[:, 0] >= PASSES * unobstructed
        faces = (normals * towards).sum(1) >= FACES
        return pixels[:, 0] * torch.stack([passes | faces, passes & faces])

    def _places(self) -> LimbPlaces:
        """Where on the body Gaussians are."""
        means = self.gaussians.means.detach()
        joints = transform_points(
            invert_rigid(self.rest_from_canonical), shaped_joints(self.body, self.betas)
        )
        return limb_places(
            means.cpu(), self.weights_at(self.gaussians.means).cpu(), joints.cpu(),
            self.canonical_vertices.cpu(), self.body,
        )  # fmt: skip


def inpainted(
    points: Float64[np.ndarray, "N 3"],
    values: Float64[np.ndarray, "N D"],
    known: Bool[np.ndarray, " N"],
) -> Float64[np.ndarray, "N D"]:
    """Values that are known, and between them those of least total variation over neighbours.

    What no known point is connected with becomes its own mean.

    Args:
        points: metres.
        values: those of unknown points hardly count.
        known: which values stay.
    """
    links = neighbour_weights(points)
    unknown, outer = np.flatnonzero(~known), np.flatnonzero(known)
    rows = links[unknown].tocoo()
    here, there = unknown[rows.row], rows.col
    filled = values.copy()
    for turn in range(ROUNDS):
        apart = np.linalg.norm(filled[here] - filled[there], axis=1).clip(ALIKE) if turn else 1.0
        weights = csr_matrix((rows.data / apart, (rows.row, there)), shape=rows.shape)
        total = np.asarray(weights.sum(1)).ravel() + OWN
        inner = diags_array(total) - weights[:, unknown]
        given = weights[:, outer] @ values[outer] + OWN * values[unknown]
        filled[unknown] = splu(inner.tocsc()).solve(given)
    return filled


def neighbour_weights(points: Float64[np.ndarray, "N 3"]) -> csr_matrix:
    """Symmetric weights [N,N] of nearest neighbours, nearer ones weighing more."""
    indices = neighbour_indices(torch.from_numpy(points), NEIGHBOURS).numpy()
    distances = np.linalg.norm(points[indices] - points[:, None], axis=-1)
    weights = FAR + np.exp(-((distances / np.median(distances)) ** 2))
    rows = np.repeat(np.arange(len(points)), indices.shape[1])
    links = csr_matrix((weights.ravel(), (rows, indices.ravel())), shape=(len(points),) * 2)
    return links.maximum(links.T)
