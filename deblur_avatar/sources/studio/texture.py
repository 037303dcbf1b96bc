"""Procedural texture: colours of skin, hair and clothes by the place on the resting body.

Conventions. Patterns are written in sRGB and handed over as linear light. Metres; the person faces
+Z. N places.
"""

from typing import Annotated

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from pydantic import Field

from deblur_avatar.config.section import Fraction, Params, Positive
from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.rendering.mesh_rendering import cell_middles, used_cells
from deblur_avatar.sources.studio.clothes import PIECES, Clothed
from deblur_avatar.sources.studio.garments import Landmarks

CELLS = 8  # along a triangle's edge: 1 to 3 mm, finer than a pixel of 4 mm sees

SKIN, LIPS, BROWS = (0.84, 0.63, 0.52), (0.74, 0.36, 0.35), (0.24, 0.15, 0.10)
WHITE, BLACK, IRIS = (0.95, 0.95, 0.93), (0.06, 0.06, 0.07), (0.18, 0.33, 0.42)
RED, YELLOW, NAVY, TEAL = (
    (0.80, 0.13, 0.14),
    (0.97, 0.80, 0.20),
    (0.10, 0.16, 0.36),
    (0.10, 0.45, 0.48),
)
HAIR, GREY = (0.30, 0.18, 0.10), (0.55, 0.57, 0.60)

# Letters of 5 x 7 dots, row by row from the top, the lowest bit to the right.
_LETTERS = {
    "S": (14, 17, 16, 14, 1, 17, 14), "H": (17, 17, 17, 31, 17, 17, 17),
    "A": (14, 17, 17, 31, 17, 17, 17), "R": (30, 17, 17, 30, 20, 18, 17),
    "P": (30, 17, 17, 30, 16, 16, 16), "2": (14, 17, 1, 6, 8, 16, 31),
    "4": (2, 6, 10, 18, 31, 2, 2),
}  # fmt: skip

Colours = Float[np.ndarray, "N 3"]
Places = Float[np.ndarray, "N 3"]


Channel = Annotated[int, Field(ge=0, le=2)]


class LookParams(Params):
    """How another person's colours differ from the studio's: dyed, printed cloth, other skin."""

    dye: tuple[Channel, Channel, Channel]  # which of red, green, blue each channel of cloth shows
    wider: Positive  # times: stripes and checks
    print_depth: Fraction  # share of the light that a mottled print takes from cloth
    print_m: Positive  # metres from one spot of it to the next
    tan: Fraction  # share of the light that skin takes


def paint(clothed: Clothed, look: LookParams | None = None) -> Float32[np.ndarray, "T R R 3"]:
    """Colour every cell of every triangle: linear light, R = `CELLS`; no look is the studio's."""
    surface, (u, v) = clothed.surface, cell_middles(CELLS)
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    places = a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]
    facing = surface.normals[surface.faces].mean(1)
    srgb = np.zeros(places.shape)
    for index, piece in enumerate(PIECES):
        chosen = clothed.pieces == index
        flat = places[chosen].reshape(-1, 3)
        outward = np.repeat(facing[chosen], len(u), axis=0)
        wider = 1.0 if look is None else look.wider
        colours = _PAINTERS[piece](flat, outward, clothed.landmarks, wider)
        if look is not None:
            colours = _changed(colours, piece, flat, look)
        srgb[chosen] = colours.reshape(-1, len(u), 3)
    linear = srgb_to_linear(torch.from_numpy(srgb.clip(0, 1))).numpy()
    table = np.zeros((len(a), CELLS, CELLS, 3), np.float32)
    table[:, *used_cells(CELLS)] = linear
    return table


def _changed(colours: Colours, piece: str, places: Places, look: LookParams) -> Colours:
    if piece == "skin":
        return colours * (1 - look.tan)
    if piece == "hair":
        return colours
    spots = 0.5 + 0.5 * _mottle(places, look.print_m)
    return colours[:, list(look.dye)] * (1 - look.print_depth * spots)[:, None]


def _skin(places: Places, outward: Places, marks: Landmarks, wider: float) -> Colours:
    x, y, z = marks.in_head(places).T
    colours = _plain(SKIN, len(places)) * (1 + 0.02 * _mottle(places, 0.06))[:, None]
    face = (z > 0.1) & (y > -0.3)
    side = np.abs(x)
    cheek = np.exp(-(((side - 0.17) / 0.09) ** 2) - ((y - 0.2) / 0.09) ** 2)
    colours = _blend(colours, (0.86, 0.47, 0.42), 0.35 * face * cheek)
    mouth = ((x / 0.125) ** 2 + ((y - 0.095 + 0.15 * x * x) / 0.045) ** 2 < 1) & face
    colours[mouth] = LIPS
    colours[mouth & (np.abs(y - 0.095) < 0.008)] = (0.35, 0.12, 0.13)
    brow = (np.abs(y - 0.57 + 0.6 * (side - 0.15) ** 2) < 0.026) & (np.abs(side - 0.15) < 0.1)
    colours[brow & face] = BROWS
    eye = (((side - 0.145) / 0.078) ** 2 + ((y - 0.45) / 0.042) ** 2 < 1) & face
    rim = (((side - 0.145) / 0.09) ** 2 + ((y - 0.455) / 0.056) ** 2 < 1) & face
    colours[rim] = (0.32, 0.2, 0.16)
    colours[eye] = WHITE
    around = np.hypot(side - 0.145, y - 0.45)
    colours[eye & (around < 0.042)] = IRIS
    colours[eye & (around < 0.02)] = BLACK
    return colours


def _shirt(places: Places, outward: Places, marks: Landmarks, wider: float) -> Colours:
    x, y, z = places.T
    around = 0.15 * np.arctan2(x, z - marks.of("spine2")[2])  # metres along the waist
    colours = _stripes(around + 0.006, 0.04 * wider, WHITE, TEAL, 0.3)
    colours[outward[:, 1] > 0.8] = WHITE
    shoulder, elbow = marks.of("left_shoulder")[0], marks.of("left_elbow")[0]
    sleeve = np.abs(x) > shoulder + 0.03
    rings = (np.abs(x) - shoulder) / (elbow - shoulder)
    colours[sleeve] = RED
    colours[sleeve & (np.abs(rings - 0.36) < 0.035)] = WHITE
    colours[sleeve & (np.abs(rings - 0.52) < 0.035)] = WHITE
    hem = y < marks.of("pelvis")[1] - 0.02
    colours[hem] = RED
    neck = marks.of("neck") + (0, 0.035, 0)
    colours[np.linalg.norm((places - neck) * (1, 0.9, 1), axis=1) < 0.122] = RED
    chest = marks.of("spine3")[1]
    front, back = outward[:, 2] > 0.1, outward[:, 2] < -0.1
    for side, sign in ((front, 1.0), (back, -1.0)):
        _write(colours, "24", side, sign * x, y - (chest - 0.19), 0.021)
    _write(colours, "SHARP", back, -x, y - (chest + 0.0), 0.0095)
    return colours


def _shorts(places: Places, outward: Places, marks: Landmarks, wider: float) -> Colours:
    x, y, z = places.T
    around = np.where(np.abs(outward[:, 0]) > 0.7, z, x)
    colours = _plain((0.13, 0.27, 0.20), len(places))
    for along in (around, y):
        phase = (along / (0.052 * wider)) % 1
        colours = _blend(colours, NAVY, 0.75 * (np.abs(phase - 0.5) < 0.2))
        colours = _blend(colours, YELLOW, 0.8 * (np.abs(phase - 0.06) < 0.045))
        colours = _blend(colours, RED, 0.7 * (np.abs(phase - 0.9) < 0.045))
    return colours


def _socks(places: Places, outward: Places, marks: Landmarks, wider: float) -> Colours:
    top = marks.of("left_ankle")[1] + 0.16 - places[:, 1]
    colours = _plain(WHITE, len(places))
    colours[(np.abs(top - 0.035) < 0.01) | (np.abs(top - 0.065) < 0.01)] = RED
    return colours


def _shoes(places: Places, outward: Places, marks: Landmarks, wider: float) -> Colours:
    x, y, z = places.T
    ankle = marks.of("left_ankle")
    sole = places[:, 1].min() + 0.022
    colours = _plain(NAVY, len(places))
    side = np.abs(outward[:, 0]) > 0.55
    colours[side & (np.abs(((z - 0.6 * y) / 0.045) % 1 - 0.5) < 0.14)] = YELLOW
    laces = (outward[:, 1] > 0.4) & (z > ankle[2] + 0.03) & (z < ankle[2] + 0.13)
    colours[laces & ((z / 0.018) % 1 < 0.5)] = WHITE
    colours[z > ankle[2] + 0.175] = RED
    colours[y < sole] = WHITE
    return colours


def _hair(places: Places, outward: Places, marks: Landmarks, wider: float) -> Colours:
    x, y, z = marks.in_head(places).T
    around = np.arctan2(x, z - 0.05)
    strands = np.sin(38 * around + 4 * np.sin(7 * y)) + 0.6 * np.sin(91 * around + 9 * y)
    bright = 1 + 0.22 * strands + 0.5 * np.exp(-(((y - 0.75) / 0.07) ** 2))
    return np.asarray(HAIR) * bright[:, None]


_PAINTERS = {
    "skin": _skin, "shirt": _shirt, "shorts": _shorts,
    "socks": _socks, "shoes": _shoes, "hair": _hair,
}  # fmt: skip


def _plain(colour: tuple[float, float, float], count: int) -> Colours:
    return np.tile(np.asarray(colour, float), (count, 1))


def _stripes(
    along: Float[np.ndarray, " N"],
    period: float,
    ground: tuple[float, float, float],
    stripe: tuple[float, float, float],
    share: float,
) -> Colours:
    colours = _plain(ground, len(along))
    colours[(along / period) % 1 < share] = stripe
    return colours


def _blend(
    colours: Colours, other: tuple[float, float, float], share: Float[np.ndarray, " N"]
) -> Colours:
    return colours + share[:, None] * (np.asarray(other) - colours)


def _mottle(places: Places, size: float) -> Float[np.ndarray, " N"]:
    """A soft irregular pattern between -1 and 1."""
    a, b, c = (2 * np.pi * places / size).T
    return np.sin(a + 1.3 * np.sin(0.7 * b)) * np.sin(b + 1.1 * np.sin(0.6 * c)) * np.cos(0.8 * c)


def _write(
    colours: Colours,
    text: str,
    where: Bool[np.ndarray, " N"],
    x: Float[np.ndarray, " N"],
    y: Float[np.ndarray, " N"],
    dot: float,
) -> None:
    """Print red letters with a white edge, standing on y = 0 and centred on x = 0.

    `x` grows to the reader's right, whichever way the wearer's goes.
    """
    columns = 6 * len(text) - 1
    edge = _dots(text, x / dot + columns / 2, y / dot, 0.55) & where
    colours[edge] = WHITE
    colours[_dots(text, x / dot + columns / 2, y / dot, 0.0) & where] = RED


def _dots(
    text: str, column: Float[np.ndarray, " N"], row: Float[np.ndarray, " N"], grow: float
) -> Bool[np.ndarray, " N"]:
    """Whether each place lies on a dot of the text, dots grown by `grow` on every side."""
    grid = np.zeros((9, 6 * len(text) + 1), bool)
    for index, letter in enumerate(text):
        for line, bits in enumerate(_LETTERS[letter]):
            for bit in range(5):
                grid[7 - line, 6 * index + 1 + bit] = bits >> (4 - bit) & 1
    found = np.zeros(len(column), bool)
    for right in (-grow, grow):
        for up in (-grow, grow):
            c = np.clip(np.floor(column + right).astype(int) + 1, 0, grid.shape[1] - 1)
            r = np.clip(np.floor(row + up).astype(int) + 1, 0, grid.shape[0] - 1)
            found |= grid[r, c]
    return found
