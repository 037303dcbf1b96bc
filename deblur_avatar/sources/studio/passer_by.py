"""Passer-by: another clothed person who walks past, before or behind the one who is filmed."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.config.section import Params, Positive
from deblur_avatar.sources.studio.motion import Moves, move
from deblur_avatar.sources.studio.person import Person, create_person

BETAS = (0.5, -0.6, 0.3, -0.2, 0.4)  # unlike those of the person filmed
COLOURS = [2, 0, 1]  # which channel of the person's clothes each of the passer-by's takes


class PasserByParams(Params):
    """Where the other one walks: along x, at one depth."""

    depth_m: float  # z; negative is behind the person
    speed_m_s: Positive
    middle_s: float  # when she is before or behind the person


@dataclass(frozen=True)
class PasserBy:
    """Someone who walks along x and faces the way she goes."""

    person: Person
    params: PasserByParams

    @property
    def in_front(self) -> bool:
        """Whether she passes between the person and the camera."""
        return self.params.depth_m > 0

    def moves(self, times: Float[Tensor, " M"]) -> Moves:
        """Her poses at some times, seconds."""
        walking = move("walk", times, 1.0)
        place = walking.transl.clone()
        place[:, 0] += self.params.speed_m_s * (times - self.params.middle_s)
        place[:, 2] += self.params.depth_m
        turn = torch.tensor([0.0, np.pi / 2, 0.0], dtype=place.dtype)
        return replace(walking, global_orient=turn.expand(len(times), 3), transl=place)

    def instants(self, times: Float[Tensor, " M"]) -> list[Float32[np.ndarray, "P 3"]]:
        """Her vertices at some times."""
        return list(self.person.posed(self.moves(times)))


def create_passer_by(body: Body, params: PasserByParams) -> PasserBy:
    """Dress another person, in other colours."""
    betas = torch.zeros(body.shape_dirs.shape[2])
    betas[: len(BETAS)] = torch.tensor(BETAS)[: len(betas)]
    person = create_person(body, betas)
    mesh = replace(person.mesh, albedo=np.ascontiguousarray(person.mesh.albedo[..., COLOURS]))
    return PasserBy(replace(person, mesh=mesh), params)
