"""Pictures of the self-check: the fitted avatar in its training frames, and from all sides.

What lies farther from the body than clothes and hair may stand is red.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import UInt8

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.evaluation.avatar_measures import Look
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.contact_sheets import contact_sheet
from deblur_avatar.reporting.findings_table import findings_table
from deblur_avatar.reporting.page import picture_uri, render_page

Picture = UInt8[np.ndarray, "_ _ 3"]

TEMPLATE = Path(__file__).parent / "self_check.html.jinja"
FRAMES, COLUMNS, HEIGHT = 4, 4, 300  # exposures shown; pictures a row; pixels
FAINT = 0.05  # coverage from which a pixel outside is marked
RED, STRENGTH = (1.0, 0.0, 0.0), 0.7


def draw_self_check(
    observations: Observations, filmed: Mapping[int, Look], sides: Sequence[Look]
) -> Picture:
    """Blurred frames, what the avatar makes of them, and its turntable, in one sheet.

    Args:
        observations: the blurred ones.
        filmed: averaged renders by position.
        sides: renders from all sides.
    """
    chosen = evenly_spaced(list(filmed), FRAMES)
    frames = [_scaled(observations.frames[position].numpy()) for position in chosen]
    renders = [_scaled(_marked(filmed[position])) for position in chosen]
    labels = [f"frame {observations.frame_indices[position]}" for position in chosen]
    turns = [f"{360 * side // len(sides)} degrees" for side in range(len(sides))]
    return contact_sheet(
        [*frames, *renders, *(_scaled(_marked(look)) for look in sides)],
        min(COLUMNS, len(chosen)),
        [*labels, *(f"{label}, explained" for label in labels), *turns],
    )


def self_check_page(name: str, content: Mapping[str, Any], sheet: Picture) -> str:
    """The findings and the sheet on one page that loads nothing."""
    return render_page(
        TEMPLATE,
        name=name,
        check=content,
        findings=findings_table(content["findings"]),
        sheet=picture_uri(sheet),
    )


def _marked(look: Look) -> Picture:
    """A look on white, with what lies outside in red."""
    white = look.image + (1 - look.alpha[..., None])
    strength = (look.outside > FAINT)[..., None] * STRENGTH
    shown = torch.lerp(white, torch.tensor(RED).expand_as(white), strength)
    return np.asarray((shown.clamp(0, 1) * 255).round().to(torch.uint8))


def _scaled(picture: Picture) -> Picture:
    size = (max(1, round(picture.shape[1] * HEIGHT / picture.shape[0])), HEIGHT)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR))
