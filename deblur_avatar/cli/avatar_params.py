"""Avatar parameters: the params.yaml of one person's video, the user's to change once written."""

import io
import os
import re
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from deblur_avatar.cli.homes import PARAMS, Home, home_of
from deblur_avatar.config.reading import (
    expand_environment,
    holds_variable,
    read_params,
    read_yaml,
    section_of,
)
from deblur_avatar.errors import ConfigError
from deblur_avatar.files import write_text
from deblur_avatar.parameters import check_parameters
from deblur_avatar.sources.footage import check_readable

PAGE = "avatar.html"
BODY = "anny"
WIDTH = 10_000  # of lines that are written: folded, a path with two spaces in a row is another one
LONGEST = 200  # letters of a name; what is called after it has 40 more, a disk takes 255
ON_A_PAGE = {"plain", "one_sided"}  # kinds of avatars without networks
ESTIMATED_POSE_STD = 8.0  # degrees that a pose found by a detector may be off, at a joint
DEFAULT_AVATAR = "paper"
# Of methods to which a video of one's own is another recipe than a scene: people rarely turn.
OF_VIDEOS = {"lean": "one_sided"}
ADDED_TO = (
    "warmups",
    "runs",
    "self_checks",
    "animations",
    "exports",
)  # sections that each method asked for grows
HEADER = """\
# One person's video. Change what you know better, then run the same command again; every key of
# `clip` is explained in docs/your-own-footage.md. What is not here is that of the file `shared`.

"""


def prepare(video: Path, name: str, method: str, schedule: str | None, here: Path) -> Home:
    """Write an avatar's parameters, unless they are there, and its pipeline.

    Args:
        video: a video file or a folder of pictures.
        name: of the avatar; letters, digits and `_`, `LONGEST` at most.
        method: a row of the tables.
        schedule: of `params.yaml`; None: what the avatar's file says, `large` in a new one.
        here: where the command was started.

    Raises:
        ConfigError: if there is no such video, name, method or schedule, the folder is taken, or
            no parameter file can say what the video is called.
        ArtifactError: if the video cannot be read, or the disk refuses.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ConfigError(f"--name {name}: a name is small letters, digits and _, a letter first")
    if len(name) > LONGEST:
        raise ConfigError(f"--name {name:.20}...: {len(name)} letters, choose {LONGEST} at most")
    home = home_of(name, here)
    source = home.source / PARAMS
    shared = read_params(source)
    _check_asked(shared, source, method, schedule)
    path = home.folder / PARAMS
    if path.is_file():
        content = _own(path, name, video)
    else:
        check_readable(video)  # at once, not after minutes
        content = _new(name, video)
    recipe = _recipe(content, name, method, section_of(shared, source, "avatars", dict))
    kind = section_of(shared, source, f"avatars.{recipe}.model.kind", str)
    content = _with_method(content, name, method, recipe, kind)
    if schedule is not None:
        content["schedule"] = schedule
    if home.independent:
        content["bodies"] = {BODY: section_of(shared, source, f"bodies.{BODY}", dict)} | content[
            "bodies"
        ]
    snapshots = section_of(shared, source, "snapshots", int)
    content = {"snapshots": snapshots} | content
    content |= {"shared": f"{home.up}/{PARAMS}", "from": _places(content, home.up)}
    home.install()
    _write(path, content)
    check_parameters(path)
    return home


def name_of(video: Path) -> str:
    """A name for an avatar, from its file's."""
    name = re.sub(r"[^a-z0-9]+", "_", video.stem.lower()).strip("_")
    name = name if name[:1].isalpha() else f"v_{name}" if name else "video"
    return name[:LONGEST]


def _check_asked(shared: Any, source: Path, method: str, schedule: str | None) -> None:
    """Refuse rows that the tables lack, and methods that no blurred video can be fitted by."""
    others = section_of(shared, source, "observations", dict[str, str])
    rows = map(str, section_of(shared, source, "methods", dict))
    methods = [name for name in rows if name not in others]
    if method in others:
        raise ConfigError(
            f"--method {method} is fitted to {others[method]} observations, a video has blurred "
            f"ones alone; choose among {', '.join(methods)}"
        )
    if method not in methods:
        raise ConfigError(f"no method {method!r}, there is {', '.join(methods)}")
    schedules = [str(name) for name in section_of(shared, source, "schedules", dict)]
    if schedule is not None and schedule not in schedules:
        raise ConfigError(f"no schedule {schedule!r}, there is {', '.join(schedules)}")


def _new(name: str, video: Path) -> dict[str, Any]:
    clip = {
        "source": "monocular",
        "path": _told_path(video),
        "frames": [0, None],
        "stride": 1,
        "fps": 30.0,
        "image_height": 720,
        "focal": "estimated",
        "field_of_view": 60.0,
        "exposure_s": "estimated",
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
            "poses": "estimated_in_detail",
            "masks": "estimated",
            "background": "auto",
            # By the detector's guess and feet that stand; refined on one camera alone it drifts.
            "depth": "known",
            "pose_std_degrees": ESTIMATED_POSE_STD,
            "margin": 0.1,
            "validation_stride": 10,
        },
    }
    return {
        "seed": 0,
        "schedule": "large",
        "scenes": {name: scene},
        "warmups": {},
        "runs": {},
        "self_checks": {},
        "animations": {},
        "exports": {},
    }


def _told_path(video: Path) -> str:
    """A video's path, which is the same once it was read from a parameter file."""
    path = str(video.resolve())
    if holds_variable(path):
        raise ConfigError(
            f"{path}: $(...) and ${{...}} are variables in {PARAMS}; rename what is called so"
        )
    text = io.StringIO()
    _yaml().dump([path], text)
    unicode = path.encode(errors="replace").decode() == path
    if not unicode or YAML(typ="safe", pure=True).load(text.getvalue()) != [path]:
        raise ConfigError(f"{path!a}: {PARAMS} cannot keep such letters; rename what is called so")
    return path


def _own(path: Path, name: str, video: Path) -> dict[str, Any]:
    """What is in an avatar's file, once it is of this video and can be added to."""
    content: dict[str, Any] = read_yaml(path)
    known = section_of(content, path, f"scenes.{name}.clip.path", str)
    for section in ("self_checks", "exports"):  # older files have none
        content.setdefault(section, {})
    for section in ADDED_TO:
        section_of(content, path, section, dict)
    for animation in content["animations"].values():
        if isinstance(animation, dict):  # older ones were on black
            animation.setdefault("backdrop", 0.0)
    if not _same_file(path.parent / expand_environment(known, f"{path}: clip.path"), video):
        raise ConfigError(
            f"{path} is of {known!r}; choose another --name for {video}, or change it"
        )
    return content


def _same_file(known: Path, video: Path) -> bool:
    try:
        return os.path.realpath(known) == os.path.realpath(video)
    except ValueError:  # letters that no path can have
        return False


def _files(kind: str) -> dict[str, Any]:
    """What other programs open of an avatar of this kind; a page, where it has no networks."""
    motion = {"fps": 30.0, "seconds": 8.0}
    motions = {"motions": ["own", "builtin:jumping_jacks"], **motion}
    page = {PAGE: {"format": "page", **motions, "pictures": 12}}
    return (page if kind in ON_A_PAGE else {}) | {
        "rig.glb": {"format": "gltf_rig", **motions},
        "pose.ply": {"format": "ply", "frame": 0},
        "motion.bvh": {"format": "bvh", "motion": "own", **motion},
        "motion.npz": {"format": "npz"},
    }


def _recipe(content: dict[str, Any], name: str, method: str, recipes: dict[str, Any]) -> str:
    """What a method's run is fitted by: what an avatar's file says, or what a new one gets."""
    said = content["runs"].get(f"{name}-{method}")
    if isinstance(said, dict) and said.get("avatar") in recipes:
        return str(said["avatar"])
    own = (OF_VIDEOS.get(method), method)
    return next((name for name in own if name in recipes), DEFAULT_AVATAR)


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
        "backdrop": 0.5,
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


def _places(content: dict[str, Any], up: str) -> dict[str, str]:
    """Where the pipeline finds what an avatar's folder does not make or say: at the root."""
    sections = ("schedules", "avatars", "methods", "check")
    return {
        "root": up,
        "bodies": "data/body" if content["bodies"] else f"{up}/data/body",
        "footage": "data",
        **{name: PARAMS if name in content else f"{up}/{PARAMS}" for name in sections},
    }


def _write(path: Path, content: dict[str, Any]) -> None:
    """Write a new file, or add to the user's what it lacks; its comments and its order stay."""
    yaml, text = _yaml(), io.StringIO()
    if path.is_file():
        if read_yaml(path) == content:
            return
        whole = yaml.load(path.read_bytes())
        _add(whole, content)
    else:
        text.write(HEADER)
        whole = content
    yaml.dump(whole, text)
    write_text(path, text.getvalue())


def _yaml() -> YAML:
    """What reads and writes an avatar's file: quotes stay, nothing is `null`."""
    yaml = YAML()
    yaml.width = WIDTH
    yaml.preserve_quotes = True
    yaml.representer.add_representer(
        type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    return yaml


def _add(known: Any, content: dict[str, Any]) -> None:
    """Set what a part of a file says otherwise, or does not say."""
    for key, value in content.items():
        if isinstance(value, dict) and isinstance(known.get(key), dict):
            _add(known[key], value)
        elif key not in known or known[key] != value:
            known[key] = value
