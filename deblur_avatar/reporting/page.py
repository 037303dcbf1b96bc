"""HTML pages that load nothing: one frame, one style and one table for every report."""

import base64
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from jaxtyping import UInt8

from deblur_avatar.imaging.picture_files import jpeg_bytes

FRAME = Path(__file__).parent / "page.html.jinja"


def render_page(template: Path, **content: Any) -> str:
    """Fill a template in.

    Args:
        template: extends `page.html.jinja`, which also has the macros `table` and `chart`.
        content: what the template names; a name that is missing is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([template.parent, FRAME.parent]),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(template.name).render(**content) + "\n"


def data_uri(content: bytes, kind: str) -> str:
    """A file as the address of itself."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def picture_uri(picture: UInt8[np.ndarray, "_ _ 3"]) -> str:
    """A picture as a JPEG data address."""
    return data_uri(jpeg_bytes(picture), "image/jpeg")
