"""The seam between avatars and all that fits, renders, scores or animates them.

An avatar is a person in a canonical pose (Vitruvian) that any joint transforms move. Splats, meshes
with Gaussians and volumes fit behind the same calls: `condition` once a frame, `render` at any
instants of its exposure. A kind is a module of this package and its name in `kinds.py`
(docs/extending.md). World coordinates, metres; S instants, J joints.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.avatar import (
    Avatar,
    composition_on_disk,
    no_gaussians,
    part_in_code,
    part_on_disk,
)
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.gaussian_edits import Edits
from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.avatars.params import AvatarParams, DensifyParams, FittingParams, Precision
from deblur_avatar.bodies.posed_body import (
    shaped_vertices,
    transforms_from_rotations,
    vitruvian_transforms,
)
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.geometry.skinning import invert_rigid, skin_points
from deblur_avatar.rendering.result import Rasterization

GAUSSIANS = "gaussians."  # what names of the Gaussians' tensors begin with
# Named parameters by the name of their learning rate.
ParameterGroups = dict[str, list[tuple[str, nn.Parameter]]]
# Penalties by the names of their weights, each computed when it is called.
Regularisers = dict[str, Callable[[], Float[Tensor, ""]]]


@dataclass(frozen=True)
class TrainingStep:
    """One step of fitting: how far it has come, and where its random draws come from.

    `scale` is that of the schedule against the paper's 15,000 iterations, in which parameters say
    when something starts. `fitting` is of the avatar's class `Fitting`.
    """

    iteration: int
    scale: float
    fitting: Any
    generator: torch.Generator

    def past(self, paper_iteration: int) -> bool:
        """Whether an iteration of the paper's has gone by."""
        return self.iteration > paper_iteration * self.scale


@dataclass(frozen=True)
class FrameState:
    """What an avatar knows of one frame at all of its instants; kinds add their own."""

    frame: int
    pose_code: Float[Tensor, " E"] | None  # of the networks that encode the pose


@dataclass(frozen=True)
class Rendering:
    """Renders of S instants, or their mean; light as it is averaged, over the background.

    `rasterization` is what densification reads, of kinds that are made of Gaussians.
    """

    image: Float[Tensor, "pictures H W 3"]
    alpha: Float[Tensor, "pictures H W"]
    instants: int  # S
    rasterization: Rasterization | None


class AvatarModel(nn.Module, ABC):
    """An avatar with its unknowns.

    `kind` names it in `params.yaml`; `Params` says what it is made of and is saved with it,
    `Fitting` says how it is fitted.
    """

    kind: ClassVar[str]
    Params: ClassVar[type[AvatarParams]]
    Fitting: ClassVar[type[FittingParams]]
    # Joints, and how deep inside the silhouette one may not see through their surface: as
    # `closure_views` has it.
    closed_nearer: ClassVar[Mapping[str, float]] = {}
    betas: Tensor
    canonical_vertices: Tensor
    rest_from_canonical: Tensor

    def __init__(
        self, params: Any, body: Body, betas: Tensor, frames: int, averaging_space: str
    ) -> None:
        super().__init__()
        self.params, self.body, self.frames, self.averaging_space = (
            params,
            body,
            frames,
            averaging_space,
        )
        canonical = vitruvian_transforms(body, betas)
        vertices = canonical_vertices(body, betas)
        self.register_buffer("betas", betas, persistent=False)
        self.register_buffer("canonical_vertices", vertices, persistent=False)
        self.register_buffer("rest_from_canonical", invert_rigid(canonical), persistent=False)
        self._copies: tuple[Tensor, Tensor] | None = None

    @classmethod
    @abstractmethod
    def create(
        cls, params: Any, body: Body, betas: Tensor, frames: int, count: int, averaging_space: str,
        generator: torch.Generator,
    ) -> "AvatarModel":  # fmt: skip
        """A new avatar on the canonical body.

        Args:
            params: of its `Params`.
            body: that it is to move with.
            betas: the body's shape.
            frames: of the clip, for what belongs to one frame.
            count: Gaussians of the schedule, of kinds that are made of them.
            averaging_space: the space in which its light is averaged.
            generator: of what is drawn at random.
        """

    @classmethod
    def rebuilt(cls, avatar: Avatar, params: Any, body: Body) -> "AvatarModel":
        """The avatar that was saved, before its networks or grids are filled in."""
        saved = avatar.model
        return cls(params, body, avatar.betas, saved["frames"], saved["light"])

    @classmethod
    def from_artifact(cls, avatar: Avatar, params: Any, body: Body) -> "AvatarModel":
        """Rebuild what `to_artifact` saved; `params` are of its `Params`.

        Raises:
            ArtifactError: if what was saved is not of these parameters.
        """
        model = cls.rebuilt(avatar, params, body)
        own = {name for name in model.state_dict() if not name.startswith(GAUSSIANS)}
        wanted = {part_on_disk(name) for name in own}
        if wanted != avatar.networks.keys():
            odd = sorted(wanted ^ avatar.networks.keys())
            raise ArtifactError(f"avatar/1: networks do not fit model: {odd}; run `dvc repro`")
        networks = {part_in_code(name): value for name, value in avatar.networks.items()}
        model.load_state_dict(networks, strict=False)
        return model

    def to_artifact(self, iteration: int) -> Avatar:
        """What a later stage, or another program, needs to render this avatar."""
        self.invalidate_neighbours()
        # Clones: fitting works in place, and an artifact never changes.
        state = {name: value.cpu().clone() for name, value in self.state_dict().items()}
        gaussians = no_gaussians() if self.densified is None else {}
        return Avatar(
            **gaussians,
            **{k.removeprefix(GAUSSIANS): v for k, v in state.items() if k.startswith(GAUSSIANS)},
            betas=self.betas.cpu(),
            networks={part_on_disk(k): v for k, v in state.items() if not k.startswith(GAUSSIANS)},
            model={
                "params": composition_on_disk(self.params.model_dump(mode="json")),
                "frames": self.frames,
                "light": self.averaging_space,
            },
            iteration=iteration,
        )

    @abstractmethod
    def condition(
        self,
        rotations: Float[Tensor, "J 3 3"],
        frame: int,
        transforms: Float[Tensor, "J 4 4"],
        viewmat: Float[Tensor, "4 4"],
        step: TrainingStep | None = None,
    ) -> Any:
        """Evaluate everything that does not depend on the instant; a kind's own FrameState.

        Args:
            rotations: of the joints relative to their parents, at the middle of the exposure.
            frame: training position, for what belongs to one frame.
            transforms: canonical to posed, at the middle.
            viewmat: of the camera, from which colours may depend on.
            step: of fitting; None renders the avatar as it is, without noise.
        """

    @abstractmethod
    def render(
        self,
        state: Any,
        transforms: Float[Tensor, "S J 4 4"],
        camera: Camera,
        *,
        average: bool = False,
        background: Float[Tensor, " 3"] | None = None,
    ) -> Rendering:
        """Draw the instants of one frame, or their mean, differentiably.

        Args:
            state: what `condition` gave.
            transforms: canonical to posed, at each instant.
            camera: who looks.
            average: return the mean of the S pictures instead (`imaging/exposure.py`).
            background: in the space in which light is averaged; black if None.
        """

    def render_exposure(
        self,
        state: Any,
        transforms: Float[Tensor, "instants J 4 4"],
        camera: Camera,
        *,
        average: bool,
    ) -> tuple[Rendering, Rendering]:
        """Draw the instants, and apart from them the middle, whose transforms come last."""
        mean = self.render(state, transforms[:-1], camera, average=average)
        return mean, self.render(state, transforms[-1:], camera)

    @abstractmethod
    def parameter_groups(self) -> ParameterGroups:
        """Parameters by the learning rate they take, with their names on disk.

        Those of `densified` have a group each, and their own names.
        """

    @property
    def densified(self) -> Gaussians | None:
        """The Gaussians that densification adds to and drops from; None of kinds without any."""
        return None

    def edits(
        self,
        pulls: Float[Tensor, " N"],
        params: DensifyParams,
        room: int,
        generator: torch.Generator,
    ) -> Edits | None:
        """Which Gaussians densification keeps and adds, of kinds with a rule of their own.

        Args:
            pulls: how strongly each is moved: mean length of its gradient on the screen.
            params: its `Fitting.densify`.
            room: how many more there may be.
            generator: of what is drawn at random.

        Returns:
            None for the usual rule (`training/densify.py`).
        """
        return None

    @property
    def precision(self) -> Precision | None:
        """That of its networks; None without any."""
        return None

    @property
    def pose_code_size(self) -> int:
        """Length of the frame states' pose code; 0 without one."""
        return 0

    def regularisers(self, rendering: Any, step: TrainingStep) -> Regularisers:
        """Its own penalties, by names that its `Fitting.weights` knows."""
        return {}

    def pretrain(self, generator: torch.Generator) -> None:
        """Teach it what is known before the first frame is looked at."""

    def fill_untrained_latents(self, trained: Sequence[int]) -> None:
        """Give frames that were not trained on what belongs to one frame."""

    def inpaint(
        self, fitting: Any, observations: Observations, centre: Poses, *, finished: bool
    ) -> None:
        """Give what no frame shows the looks of what frames show, of kinds that do.

        Args:
            fitting: of its class `Fitting`.
            observations: that it was fitted to.
            centre: poses at the middle of each frame.
            finished: whether fitting is over. If not, what frames show too little of for a colour
                to be sure gets those looks, too, to be fitted from there.
        """

    def invalidate_neighbours(self) -> None:
        """Forget what was looked up in space, because the avatar has moved."""

    @property
    def _on_the_cpu(self) -> tuple[Float[Tensor, " B"], Float[Tensor, "J 4 4"]]:
        """Shape and canonical pose, copied once where the avatar is on another device."""
        own = self.betas, self.rest_from_canonical
        if self.betas.device.type == "cpu":
            return own
        if self._copies is None:
            self._copies = own[0].cpu(), own[1].cpu()
        return self._copies

    def transforms(
        self,
        rotations: Float[Tensor, "*batch J 3 3"],
        transl: Float[Tensor, "*batch 3"],
    ) -> Float[Tensor, "*batch J 4 4"]:
        """Canonical-to-posed transforms of all joints, on the avatar's device.

        Joints are chained on the CPU: some hundred small numbers, for which a GPU is slow to ask.
        """
        betas, rest_from_canonical = self._on_the_cpu
        posed = transforms_from_rotations(self.body, betas, rotations.cpu(), transl.cpu())
        return (posed @ rest_from_canonical).to(self.betas.device)


def canonical_vertices(body: Body, betas: Float[Tensor, " B"]) -> Float[Tensor, "V 3"]:
    """The body's vertices in the canonical pose."""
    canonical = vitruvian_transforms(body, betas)
    return skin_points(shaped_vertices(body, betas), body.lbs_weights.to(betas), canonical)
