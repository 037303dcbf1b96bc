"""The terms that one step of fitting adds up, each already weighed.

Conventions. What has to be looked up (neighbours, places on the body) is kept until it is looked up
again. Settings that say when something starts count in the paper's 15,000 iterations.
"""

import torch
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.gaussians import (
    face_areas,
    neighbour_indices,
    sample_surface,
)
from deblur_avatar.avatars.model import AvatarModel, encode
from deblur_avatar.bodies.posed_body import joints_from_rotations
from deblur_avatar.imaging.lpips import configured_lpips
from deblur_avatar.motion.trajectory import LEVER, Instants, Trajectory
from deblur_avatar.training import losses
from deblur_avatar.training.isometry import isometry
from deblur_avatar.training.params import StartParams
from deblur_avatar.training.surface_projection import SurfaceProjection, closest_points
from deblur_avatar.training.targets import Target

ISOMETRY_NEIGHBOURS = 4  # 3DGS-Avatar: five nearest, the point itself among them
SKINNING_SAMPLES = 1024  # points on the body a step (3DGS-Avatar)
HEIGHT = 0.01  # metres off the body that weigh like a unit of a raw colour


class Objective:
    """What an avatar and its motion are held to.

    Args:
        model: the avatar.
        trajectory: its motion.
        observations: what the camera saw, and what is known of it.
        params: weights of the terms.
        scale: of the schedule against the paper's iterations.
        device: of everything.
        generator: of the points at which blend weights are compared.
    """

    def __init__(
        self,
        model: AvatarModel,
        trajectory: Trajectory,
        observations: Observations,
        params: StartParams,
        scale: float,
        device: torch.device,
        generator: torch.Generator,
    ) -> None:
        self._model, self._trajectory = model, trajectory
        self._params, self._scale, self._generator = params, scale, generator
        self._faces = model.body.faces.to(device)
        self._lbs_weights = model.body.lbs_weights.to(device)
        self._viewmat = observations.cameras.viewmats[observations.train_camera].to(device)
        self._depth_known, self._hidden = observations.depth_known, observations.hidden
        self._lpips = configured_lpips() if params.losses.lpips > 0 else None
        if self._lpips is not None:
            self._lpips = self._lpips.to(device)
        self._areas = face_areas(model.canonical_vertices, self._faces)
        self._neighbours: Tensor | None = None
        self._feet: SurfaceProjection | None = None
        self._known_depths: dict[int, Tensor | None] = {}

    @property
    def perceptual(self) -> str | None:
        """The term that sees structure, if any."""
        edges = "edges" if self._params.losses.structure > 0 else None
        return edges if self._lpips is None else "lpips_vgg"

    def invalidate_neighbours(self) -> None:
        """Forget who is next to whom and where on the body, because Gaussians have moved."""
        self._neighbours, self._feet = None, None

    def pictures(
        self, compared: list[tuple[float, Tensor]], alpha: Tensor, target: Target
    ) -> dict[str, Tensor]:
        """How far pictures (with their shares) and coverage are from a frame and its matte."""
        weights = self._params.losses
        images = [(share, encode(image, self._model.light)) for share, image in compared]
        apart = [share * losses.photometric(image, target.image) for share, image in images]
        terms = {"l1": weights.l1 * target.weight * torch.stack(apart).sum()}
        if self._lpips is not None:
            seen = [s * self._perceived(image, target) for s, image in images]
            terms["lpips"] = weights.lpips * target.weight * torch.stack(seen).sum()
        elif weights.structure > 0:
            edges = [s * losses.structure(image, target.image, target.box) for s, image in images]
            terms["structure"] = weights.structure * target.weight * torch.stack(edges).sum()
        if weights.dissimilarity > 0:
            unlike = [s * losses.dissimilarity(i, target.image, target.box) for s, i in images]
            terms["dissimilarity"] = (
                weights.dissimilarity * target.weight * torch.stack(unlike).sum()
            )
        terms["mask"] = weights.mask * target.weight * losses.coverage(alpha, target.matte)
        return terms

    def _perceived(self, image: Tensor, target: Target) -> Tensor:
        assert self._lpips is not None
        return losses.perceptual(self._lpips, image, target.image, target.box)

    def evenness(self) -> dict[str, Tensor]:
        """Gaussians are like their neighbours, by the square of what is hidden of the body."""
        weights, gaussians = self._params.losses, self._model.gaussians
        if weights.even_colors == weights.even_shapes == weights.even_heights == 0:
            return {}
        if self._feet is None:
            self._feet = closest_points(
                gaussians.means, self._model.canonical_vertices, self._faces
            )
        shapes = torch.cat([gaussians.log_scales, gaussians.opacity_logits[:, None]], dim=1)
        values = {
            "even_colors": gaussians.features,
            "even_shapes": shapes,
            "even_heights": self._feet.heights(gaussians.means)[:, None] / HEIGHT,
        }
        return {
            name: self._hidden**2 * getattr(weights, name) * losses.unevenness(value, self.near())
            for name, value in values.items()
        }

    def priors(self, index: int, instants: Instants) -> dict[str, Tensor]:
        """What is known of the motion beforehand; other cameras may have told its depth."""
        weights = self._params.losses.model_dump()
        priors = self._trajectory.priors()
        first = self._first_depths(index) if weights["depth"] > 0 else None
        if first is not None:
            # Steps towards the camera, in radians of a joint's turn.
            shift = (self._depths(instants) - first) / LEVER
            priors["depth"] = shift.square().mean()
        return {name: weights[name] * term for name, term in priors.items() if weights[name] > 0}

    @torch.no_grad()
    def _first_depths(self, index: int) -> Tensor | None:
        """The joints' depths before fitting; None where they are not known."""
        if index not in self._known_depths:
            first = self._trajectory.initial(index) if self._depth_known else None
            self._known_depths[index] = None if first is None else self._depths(first)
        return self._known_depths[index]

    def _depths(self, instants: Instants) -> Tensor:
        """How far the joints are from the camera at the middle of an exposure, metres."""
        places = joints_from_rotations(
            self._model.body, self._model.betas, instants.centre_rotations, instants.centre_transl
        )
        return places @ self._viewmat[2, :3] + self._viewmat[2, 3]

    def near(self) -> Tensor:
        """The neighbours of every Gaussian [N, 4]."""
        if self._neighbours is None:
            self._neighbours = neighbour_indices(self._model.gaussians.means, ISOMETRY_NEIGHBOURS)
        return self._neighbours

    def isometry(self, posed_means: Tensor, posed_covars: Tensor) -> dict[str, Tensor]:
        """Neighbours keep their distances, and their shapes' difference, in a pose."""
        weights = self._params.losses
        if weights.isometry_means == 0 and weights.isometry_covars == 0:
            return {}
        near = self.near()
        canonical = self._model.gaussians.means, self._model.canonical_covariances()
        return {
            "isometry_means": weights.isometry_means * isometry(canonical[0], posed_means, near),
            "isometry_covars": weights.isometry_covars * isometry(canonical[1], posed_covars, near),
        }

    def skinning(self, iteration: int) -> dict[str, Tensor]:
        """How far the avatar's blend weights are from the body's on its surface."""
        if self._params.model.skinning is None:
            return {}
        weights = self._params.losses
        early = iteration <= self._params.optimiser.skinning_switch * self._scale
        share = weights.skinning_early if early else weights.skinning_late
        return {"skinning": share * self.skinning_apart(SKINNING_SAMPLES)}

    def skinning_apart(self, samples: int) -> Tensor:
        """The same, not weighed, at so many points."""
        points, chosen, corners = sample_surface(
            self._model.canonical_vertices, self._faces, samples, self._generator, self._areas
        )
        wanted = (corners[..., None] * self._lbs_weights[self._faces[chosen]]).sum(1)
        return losses.skinning(self._model.weights_at(points), wanted)
