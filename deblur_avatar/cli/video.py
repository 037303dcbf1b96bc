"""From a video of one person to an avatar, a check and a report.

Writes avatars/<name>/params.yaml (once; it is the user's to change) and beside it a copy of the
root's dvc.yaml, checks the scene, and lets DVC make the rest: the avatar, a page that shows it in
any browser, a video of it doing what was filmed while the camera goes round, files for other
programs, and a report. All results lie below that folder.
"""

import argparse
import logging
import os
import re
import shutil
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from deblur_avatar.cli.running_dvc import check_checkout, reproduce
from deblur_avatar.config.reading import (
    read_params,
    read_yaml,
    section_of,
)
from deblur_avatar.errors import ConfigError
from deblur_avatar.evaluation.findings import failures, read_findings
from deblur_avatar.parameters import check_parameters
from deblur_avatar.pipeline.code import PIPELINE
from deblur_avatar.sources.footage import read_footage

logger = logging.getLogger(__name__)

AVATARS, PARAMS, UP = Path("avatars"), "params.yaml", "../.."
PAGE = "avatar.html"
BODY, PLAIN = "anny", "plain"
DEFAULT_AVATAR = "paper"
ADDED_TO = (
    "warmups",
    "runs",
    "self_checks",
    "animations",
    "exports",
)  # sections that each method asked for grows
HEADER = """\
# One person's video. Change what you know better, then run the same command again; every key of
# `clip` is explained in docs/your-own-footage.md. What is not here is the root's params.yaml.

"""


def prepare(video: Path, name: str, method: str, schedule: str, root: Path) -> Path:
    """Write an avatar's parameters, unless they are there, and its pipeline.

    Args:
        video: a video file or a folder of pictures.
        name: of the avatar; letters, digits and `_`.
        method: a row of the tables.
        schedule: of `params.yaml`.
        root: of the repository.

    Returns:
        The avatar's folder.

    Raises:
        ConfigError: if there is no such video, name, method or schedule.
        ArtifactError: if the video cannot be read.
    """
    shared = read_params(root / PARAMS)
    for kind, key in (("method", method), ("schedule", schedule)):
        known = section_of(shared, root / PARAMS, f"{kind}s", dict)
        if key not in known:
            raise ConfigError(f"no {kind} {key!r}, there is {', '.join(map(str, known))}")
    recipes = section_of(shared, root / PARAMS, "avatars", dict)
    recipe = method if method in recipes else DEFAULT_AVATAR  # of methods without one of their own
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ConfigError(f"--name {name}: a name is small letters, digits and _, a letter first")
    folder = root / AVATARS / name
    if (folder / PARAMS).is_file():
        content = _own(folder / PARAMS, name, video)
    else:
        read_footage(video, (0, 2), 1, 30.0, 16)  # what cannot be read is refused at once
        content = _new(name, video)
    kind = section_of(shared, root / PARAMS, f"avatars.{recipe}.model.kind", str)
    content = _with_method(content, name, method, recipe, kind) | {"schedule": schedule}
    snapshots = section_of(shared, root / PARAMS, "snapshots", int)
    content = {"snapshots": snapshots} | content | {"from": _places(content)}
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / PARAMS, content)
    check_parameters(folder / PARAMS)
    shutil.copy(root / PIPELINE, folder / PIPELINE)
    return folder


def name_of(video: Path) -> str:
    """A name for an avatar, from its file's."""
    name = re.sub(r"[^a-z0-9]+", "_", video.stem.lower()).strip("_")
    return name if name[:1].isalpha() else f"v_{name}" if name else "video"


def targets(folder: Path, method: str) -> list[str]:
    """What to ask DVC for, in order: the check, then everything of the method asked for."""
    name, pipeline = folder.name, f"{folder}/{PIPELINE}"
    run = f"{name}-{method}"
    return [
        f"{pipeline}:{stage}"
        for stage in (
            f"check@{name}",
            f"self_check@{run}",
            f"export@{run}",
            f"animate@{run}",
            f"evaluate@{run}",
        )
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("video", type=Path, help="a video file or a folder of pictures")
    parser.add_argument("--name", default="", help="of the avatar; default: after the file")
    parser.add_argument("--method", default="lean", help="a row of the tables (default: lean)")
    parser.add_argument(
        "--schedule",
        default="large",
        help="of params.yaml (default: large; medium is a quick look)",
    )


def run(asked: argparse.Namespace) -> int:
    """Prepare and run; returns DVC's exit code."""
    root = Path()
    check_checkout(root)
    folder = prepare(
        asked.video, asked.name or name_of(asked.video), asked.method, asked.schedule, root
    )
    steps = [[target] for target in targets(folder, asked.method)]
    code = reproduce(*steps, ["--single-item", f"{folder}/{PIPELINE}:report"])
    if code != 0:
        return code
    run = f"{folder.name}-{asked.method}"
    logger.info("The check:    %s/data/check/%s/index.html", folder, folder.name)
    logger.info("The avatar:   %s/data/fusion/%s/avatar", folder, run)
    logger.info("All round:    %s/data/animate/%s/video.mp4 and contact_sheet.png", folder, run)
    logger.info("The self-check: %s/data/self_check/%s/index.html", folder, run)
    logger.info("The report:   %s/reports/index.html", folder)
    _show_page(folder, run)
    _tell_verdict(folder / "metrics/self_check" / f"{run}.json")
    return 0


def _show_page(folder: Path, run: str) -> None:
    """The avatar as a page for any browser, of avatars that can be shown on one."""
    page, made = folder / PAGE, folder / "data/export" / run / PAGE
    if made.is_file():
        shutil.copyfile(made, page)
        logger.info("Turn it by hand: %s", page)
    else:
        logger.info("No page: an avatar with networks fits on none; --method lean makes one")


def _tell_verdict(path: Path) -> None:
    """The self-check's verdict in a sentence, last, so that nobody misses it."""
    content = read_findings(path)
    failed = failures(content)
    for sentence in failed:
        logger.warning("FAILED: %s", sentence)
    if failed:
        logger.warning("The avatar FAILS its self-check: do not trust what it shows.")
    else:
        logger.info("The avatar passes its self-check (%s).", content["verdict"])


def _new(name: str, video: Path) -> dict[str, Any]:
    clip = {
        "source": "monocular",
        "path": str(video.resolve()),
        "frames": [0, None],
        "stride": 1,
        "fps": 30.0,
        "image_height": 720,
        "focal": "estimated",
        "field_of_view": 60.0,
        "exposure_s": None,
        "shutter": 0.5,
        "averaging_space": "linear",
        "held_out": 0.0,
        "keypoints": None,
        "masks": None,
        "poses": None,
    }
    scene = {
        "body": BODY,
        "clip": clip,
        "blur": {"frames": "interpolated", "factor": 8, "window": 33, "averaging_space": "linear"},
        "preprocess": {
            "poses": "estimated",
            "masks": "estimated",
            "background": "auto",
            # By the detector's guess and feet that stand; refined on one camera alone it drifts.
            "depth": "known",
            "margin": 0.1,
            "validation_stride": 10,
        },
    }
    return {
        "shared": "../../params.yaml",
        "seed": 0,
        "schedule": "large",
        "scenes": {name: scene},
        "warmups": {},
        "runs": {},
        "self_checks": {},
        "animations": {},
        "exports": {},
    }


def _own(path: Path, name: str, video: Path) -> dict[str, Any]:
    """What is in an avatar's file, once it is of this video and can be added to."""
    content: dict[str, Any] = read_yaml(path)
    known = section_of(content, path, f"scenes.{name}.clip.path", str)
    for section in ("self_checks", "exports"):  # older files have none
        content.setdefault(section, {})
    for section in ADDED_TO:
        section_of(content, path, section, dict)
    if not _same_file(known, video):
        raise ConfigError(f"{path} is of {known!r}; choose another NAME for {video}, or change it")
    return content


def _same_file(known: str, video: Path) -> bool:
    try:
        return os.path.realpath(known) == os.path.realpath(video)
    except ValueError:  # letters that no path can have
        return False


def _files(kind: str) -> dict[str, Any]:
    """What other programs open of an avatar of this kind; a page, where it has no networks."""
    motion = {"fps": 30.0, "seconds": 8.0}
    motions = {"motions": ["own", "builtin:jumping_jacks"], **motion}
    page = {PAGE: {"format": "page", **motions, "pictures": 12}}
    return (page if kind == PLAIN else {}) | {
        "rig.glb": {"format": "gltf_rig", **motions},
        "pose.ply": {"format": "ply", "frame": 0},
        "motion.bvh": {"format": "bvh", "motion": "own", **motion},
        "motion.npz": {"format": "npz"},
    }


def _with_method(
    content: dict[str, Any], name: str, method: str, avatar: str, kind: str
) -> dict[str, Any]:
    """Add a run, its turntable and its files; what is there stays."""
    warmup = {"scene": name, "observations": "blurred", "avatar": avatar}
    animation = {
        "scene": name,
        "motion": "own",
        "start": 0.0,
        "seconds": 8.0,
        "fps": 24.0,
        "image_size": 512,
        "turns": 1.0,
        "travel": 0.0,
        "margin": 0.06,
    }
    run, trained = f"{name}-{method}", warmup | {"method": method}
    return (
        {
            "bodies": {},
            "predeblur": {},
            "checks": [name],
            "learning_curves": {},
            "reports": ["reports"],
            "without_pictures": [],
        }
        | content
        | {
            "warmups": {f"{name}-blurred-{avatar}": warmup} | content["warmups"],
            "runs": {run: trained} | content["runs"],
            "self_checks": {run: trained} | content["self_checks"],
            "animations": {run: animation} | content["animations"],
            "exports": {run: {"scene": name, "files": _files(kind)}} | content["exports"],
        }
    )


def _places(content: dict[str, Any]) -> dict[str, str]:
    """Where the pipeline finds what an avatar's folder does not make or say: at the root."""
    sections = ("schedules", "avatars", "methods", "check")
    return {
        "root": UP,
        "bodies": "data/body" if content["bodies"] else f"{UP}/data/body",
        "footage": "data",
        **{name: PARAMS if name in content else f"{UP}/{PARAMS}" for name in sections},
    }


def _write(path: Path, content: dict[str, Any]) -> None:
    yaml = YAML()
    yaml.width = 100
    yaml.representer.add_representer(
        type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    with path.open("w") as file:
        file.write(HEADER)
        yaml.dump(content, file)
