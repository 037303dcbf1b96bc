"""Domain randomisation: persons of shapes and colours that nobody in a scene has.

Conventions. Rest pose, metres. A part is a region of the surface that
moves with some joints; each is painted with a pattern of its own, over skin, cloth and hair alike,
so that no print, stripe or face of the studio's is left. T triangles, Q places.

Source: Tobin et al., "Domain randomization for transferring deep neural networks", IROS 2017.
"""

import math

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.bodies.posed_body import shaped_joints, shaped_vertices
from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.rendering.mesh_rendering import TexturedMesh, cell_middles, used_cells
from deblur_avatar.sources.studio.clothes import Surface, clothe
from deblur_avatar.sources.studio.drape import hang
from deblur_avatar.sources.studio.person import Person
from deblur_avatar.sources.studio.texture import CELLS
from deblur_avatar.sources.studio.unfitted_body import (
    UnfittedParams,
    unfitted_body,
    with_more_hair,
)

PARTS = (
    ("head", "neck"),
    ("spine", "collar", "shoulder"),
    ("elbow", "wrist", "hand"),
    ("pelvis", "hip"),
    ("knee",),
    ("ankle", "foot"),
)
DARKEST, BRIGHTEST = 0.05, 0.95  # sRGB
PERIODS = 0.02, 0.15  # metres, of patterns; drawn evenly by their logarithm
SHADING, SHADING_PERIOD = 0.2, 0.25  # share of light that soft stains take; metres

Places = Float[Tensor, "Q 3"]
Shares = Float[Tensor, " Q"]


def draw_person(
    body: Body, betas_deviation: float, unfitted: UnfittedParams, generator: torch.Generator
) -> Person:
    """Draw a person: shape numbers of this standard deviation, bumps, hair, and all colours."""
    betas = betas_deviation * torch.randn(body.shape_dirs.shape[2], generator=generator)
    stranger = unfitted_body(body, unfitted, generator)
    clothed = clothe(
        shaped_vertices(stranger, betas).double().numpy(),
        shaped_joints(stranger, betas).double().numpy(),
        stranger.lbs_weights.double().numpy(),
        stranger.faces.numpy(),
    )
    mesh = TexturedMesh(clothed.surface.faces.astype(np.int32), _paint(clothed.surface, generator))
    person = Person(stranger, betas, mesh, hang(clothed))
    return with_more_hair(person, unfitted.hair_mm)


def _paint(surface: Surface, generator: torch.Generator) -> Float32[np.ndarray, "T R R 3"]:
    """Linear light of every cell of every triangle, R = `CELLS`."""
    u, v = (torch.from_numpy(axis) for axis in cell_middles(CELLS))
    a, b, c = torch.from_numpy(surface.vertices[surface.faces]).unbind(1)
    places = a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]
    joints = torch.from_numpy(surface.lbs_weights[surface.faces[:, 0]]).argmax(1)
    srgb = torch.zeros_like(places)
    for names in PARTS:
        own = [i for i, name in enumerate(SMPL_JOINT_NAMES) if name.strip("_123").endswith(names)]
        chosen = torch.isin(joints, torch.tensor(own))
        pattern = _pattern(places[chosen].flatten(0, 1), generator)
        srgb[chosen] = pattern.unflatten(0, (-1, len(u)))
    table = np.zeros((len(a), CELLS, CELLS, 3), np.float32)
    table[:, *used_cells(CELLS)] = srgb_to_linear(srgb).numpy()
    return table


def _pattern(places: Places, generator: torch.Generator) -> Places:
    """Colours of one part, sRGB: two colours in a pattern, and soft stains over it."""
    colours = DARKEST + (BRIGHTEST - DARKEST) * torch.rand(
        2, 3, generator=generator, dtype=torch.float64
    )
    kind = int(torch.randint(len(_PATTERNS), (1,), generator=generator))
    low, high = (math.log(period) for period in PERIODS)
    period = math.exp(low + (high - low) * float(torch.rand(1, generator=generator)))
    share = _PATTERNS[kind](_waves(places, period, generator))[:, None]
    stains = _waves(places, SHADING_PERIOD, generator).prod(1, keepdim=True)
    blended = colours[0] + share * (colours[1] - colours[0])
    return blended * (1 - SHADING * (0.5 + 0.5 * stains))


def _waves(places: Places, period: float, generator: torch.Generator) -> Places:
    """Sines along three axes at right angles, turned at random."""
    axes = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64)).Q
    phases = 2 * math.pi * torch.rand(3, generator=generator, dtype=torch.float64)
    return (2 * math.pi / period * places @ axes + phases).sin()


def _plain(waves: Places) -> Shares:
    return torch.zeros_like(waves[:, 0])


def _stripes(waves: Places) -> Shares:
    return (waves[:, 0] > 0).double()


def _narrow_stripes(waves: Places) -> Shares:
    return (waves[:, 0] > 0.7).double()


def _checks(waves: Places) -> Shares:
    return (waves.prod(1) > 0).double()


def _dots(waves: Places) -> Shares:
    return (waves.sum(1) > 1.2).double()


def _mottle(waves: Places) -> Shares:
    return 0.5 + 0.5 * waves.prod(1)


_PATTERNS = (_plain, _stripes, _narrow_stripes, _checks, _dots, _mottle)
