"""Avatar page: the exporter. Python packs numbers, JavaScript beside it poses and draws them.

The scripts are classic parts of one module, put together in the order of `SCRIPTS`, without their
comments; a page loads nothing. Equal runs give equal bytes.
"""

from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import jinja2
from pydantic import Field

from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.page.content import Shown, page_payload
from deblur_avatar.exports.rigged import rigged_avatar
from deblur_avatar.exports.shown_motion import MotionExport, shown_motions
from deblur_avatar.files import write_bytes

FOLDER = Path(__file__).parent
SCRIPTS = (
    "payload.js", "kinematics.js", "gaussians.js", "renderer.js", "view.js", "state.js", "stage.js",
    "clip.js", "gif.js", "rotations.js", "bvh.js", "retargeting.js", "npz.js", "opened_motion.js",
    "page.js",
)  # fmt: skip
MOST_BYTES = 500_000  # of a page of so many Gaussians, whatever its frames show:
SMALL = 10_000


class PageExport(MotionExport):
    """Which motions the avatar can be shown in, and of how many instants frames go with it."""

    suffix: ClassVar[str] = ".html"

    format: Literal["page"]
    pictures: Annotated[int, Field(ge=0)]  # instants whose frames go along, if there is room

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the page of a run, and of the one beside it, if there is one."""
        write_bytes(path, self.page([run] if run.beside is None else [run, run.beside]))

    def page(self, runs: list[FittedRun]) -> bytes:
        """The whole file."""
        shown = [
            Shown(run, rigged_avatar(run), shown_motions(run, self.motions, self.fps, self.seconds))
            for run in runs
        ]
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(FOLDER),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
        )
        space = {"srgb": "sRGB values", "linear": "linear light"}[shown[0].rig.averaging_space]
        counts = " and ".join(f"{len(avatar.rig.means):,}" for avatar in shown)
        write = partial(
            environment.get_template("page.html.jinja").render,
            name=" | ".join(run.name for run in runs),
            summary=f"{counts} Gaussians, averaged as {space}",
            avatars=[run.name for run in runs],
            licence=f"Body: {runs[0].observations.body.licence}",
            style=(FOLDER / "page.css").read_text(),
            script="\n".join(_without_comments((FOLDER / name).read_text()) for name in SCRIPTS),
        )
        small = sum(len(avatar.rig.means) for avatar in shown) <= SMALL
        room = MOST_BYTES - len(_bytes(write(payload=""))) if small else None
        return _bytes(write(payload=page_payload(shown, self.pictures, room)))


def _bytes(text: str) -> bytes:
    return f"{text}\n".encode()


def _without_comments(script: str) -> str:
    """Its lines without indentation; none that are empty, or a comment alone."""
    lines = (line.strip() for line in script.splitlines())
    return "\n".join(line for line in lines if line and not line.startswith("//"))
