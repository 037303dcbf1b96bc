"""Write a fitted run as a file that other programs open.

page: the avatar in any browser, turned by hand, in its own and other motions (lean).
ply, spz, sog, gltf_splats: the avatar in the pose of one frame, for viewers of 3D Gaussian splats.
ply_sequence, usd: a motion as the splats of every frame.
gltf_rig: skeleton, motions and body, for programs that animate.
bvh, npz: a motion of the fitted skeleton; npz has the keys of AMASS.
rig_arrays: Gaussians, joints and weights as numpy arrays, for programs of your own (lean).
"""

import argparse
import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_type_hints

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.cli.run_on_disk import STAGES, check_same_frames, check_same_pictures
from deblur_avatar.config.reading import load_params, parse, read_params
from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import Exporter, FittedRun, sharp_observations
from deblur_avatar.exports.registry import EXPORTERS, ExportParams

logger = logging.getLogger(__name__)

PARAMS = "params.yaml"
# Options of formats, and what they are where they are not given; a format has some of them.
DEFAULTS: dict[str, Any] = {
    "frame": 0,
    "motion": "own",
    "motions": ["own", "builtin:jumping_jacks"],
    "fps": 30.0,
    "seconds": 10.0,
    "pictures": 12,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument(
        "run", help="a run of ./params.yaml (studio-lean), or the folder of an avatar "
        "(avatars/clip), or a run of it (avatars/clip/clip-lean)",
    )  # fmt: skip
    parser.add_argument("--format", choices=sorted(EXPORTERS), required=True)
    parser.add_argument("--out", type=Path, required=True, help="the file to write")
    parser.add_argument("--frame", type=int, help="whose pose, counted from 0 (default 0)")
    parser.add_argument(
        "--motion", help="own (what was filmed), builtin:<name> or a file: .bvh, AMASS .npz, "
        "AIST++ .pkl (of formats with one motion; default: own)",
    )  # fmt: skip
    parser.add_argument(
        "--motions", nargs="+", metavar="MOTION", help="the same (of formats with several; "
        "default: own builtin:jumping_jacks)",
    )  # fmt: skip
    parser.add_argument("--fps", type=float, help="of motions not filmed (default 30)")
    parser.add_argument("--seconds", type=float, help="the most of these (default 10)")
    parser.add_argument("--pictures", type=int, help="instants with frames (page; default 12)")
    parser.add_argument("--beside", metavar="RUN", help="another run shown beside it (page)")


def run(asked: argparse.Namespace) -> int:
    """Export; returns 0.

    Raises:
        ConfigError: if there is no such run, or the options do not fit the format or the run.
        ArtifactError: if the run was not made yet, or the file cannot be written.
    """
    exporter = _exporter(asked.format, {name: getattr(asked, name) for name in DEFAULTS})
    if asked.out.suffix != exporter.suffix:
        wanted = (
            f"file of this format ends in {exporter.suffix}"
            if exporter.suffix
            else ("folder's name has no dot: this format is a folder of files")
        )
        raise ConfigError(f"--out {asked.out}: a {wanted}")
    if asked.out.is_dir() and any(asked.out.iterdir()):
        raise ConfigError(
            f"--out {asked.out}: there are files in it, which would stand beside the new ones; "
            "empty it, or name another folder"
        )
    fitted = load_run(*find_run(asked.run))
    if asked.beside is not None:
        if asked.format != "page":
            raise ConfigError(f"--beside {asked.beside}: only a page shows two avatars")
        fitted = replace(fitted, beside=load_run(*find_run(asked.beside)))
    exporter.export(fitted, asked.out)
    files = asked.out.rglob("*") if asked.out.is_dir() else [asked.out]
    logger.info("%s: %.1f MB", asked.out, sum(file.stat().st_size for file in files) / 1e6)
    return 0


def _exporter(kind: str, given: Mapping[str, Any]) -> Exporter:
    """The exporter of a format; an option that is not given, or None, is as in `DEFAULTS`."""
    known = get_type_hints(EXPORTERS[kind])
    options = {name: value for name, value in DEFAULTS.items() if name in known}
    options |= {name: value for name, value in given.items() if value is not None}
    return parse(ExportParams, {"format": kind, **options}, "export")


def find_run(text: str) -> tuple[Path, str]:
    """The folder whose parameters name a run, and the run's name.

    Raises:
        ConfigError: if there is none, or several to choose from.
    """
    path = Path(text)
    if (path / PARAMS).is_file():
        names = list(_runs(path))
        if len(names) != 1:
            raise ConfigError(
                f"{path} has the runs {', '.join(names) or '(none)'}; name one: {path}/<run>"
            )
        return path, names[0]
    folder = path.parent
    if not (folder / PARAMS).is_file():
        raise ConfigError(f"no {PARAMS} in {folder.resolve()}, which should name the run {text!r}")
    if path.name not in _runs(folder):
        known = ", ".join(_runs(folder))
        raise ConfigError(f"no run {path.name!r} in {folder / PARAMS}, there is {known}")
    return folder, path.name


def load_run(folder: Path, name: str) -> FittedRun:
    """What the stages left of a run.

    Raises:
        ArtifactError: if it was not made yet, is damaged, or was fitted to other frames than the
            scene has now.
    """
    run: RunParams = load_params(folder / PARAMS, f"runs.{name}", RunParams)
    footage = folder / load_params(folder / PARAMS, "from.footage", str)
    prepared, fitted = footage / "preprocess" / run.scene, folder / "data/fusion" / name
    found = FittedRun(
        name=name,
        avatar=Avatar.load(fitted / "avatar"),
        motion=Motion.load(fitted / "motion"),
        observations=Observations.load(prepared / run.observations),
        sharp=sharp_observations(prepared / "sharp"),
    )
    check_same_frames(name, found.motion, found.observations)
    check_same_pictures(folder, name, STAGES[-1])
    return found


def _runs(folder: Path) -> dict[str, Any]:
    content = read_params(folder / PARAMS)
    return dict(content.get("runs") or {}) if isinstance(content, dict) else {}
