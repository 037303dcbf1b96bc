"""Parameter check: the whole of `params.yaml`, section by section, before any work."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deblur_avatar.config.reading import read_params, section_of
from deblur_avatar.config.runs import RunParams, WarmupParams
from deblur_avatar.config.section import Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.methods import MethodParams
from deblur_avatar.pipeline.animate import AnimationParams
from deblur_avatar.pipeline.blur import BlurParams
from deblur_avatar.pipeline.body import BodyParams
from deblur_avatar.pipeline.check import CheckParams
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.pipeline.export import ExportsParams
from deblur_avatar.pipeline.predeblur import PredeblurParams
from deblur_avatar.pipeline.preprocess import PreprocessParams
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams


class SceneParams(Params):
    """Footage, from its files to what fitting sees."""

    body: str
    clip: ClipParams
    blur: BlurParams
    preprocess: PreprocessParams


class PlacesParams(Params):
    """Where dvc.yaml finds, from its folder, what is not made or said there (`from`)."""

    root: str  # of the repository
    bodies: str  # folder
    footage: str  # folder of `clip` and `preprocess`
    schedules: str  # parameter files
    avatars: str
    methods: str
    check: str


# Folders below `metrics/` that belong to stages; beside them lies one folder a scene.
METRICS_OF_STAGES = frozenset(
    {
        "blur", "check", "cost", "fusion", "predeblur", "preprocess", "score_blur",
        "score_predeblur", "self_check", "learning_curve", "trajectory", "warmup",
    }
)  # fmt: skip


def check_parameters(path: Path) -> None:
    """Check a whole parameter file before any work: every section, and every name in it.

    Raises:
        ConfigError: for the first section that cannot be run.
    """
    content = read_params(path)
    sections: dict[str, Any] = {
        "schedules": ScheduleParams,
        "bodies": BodyParams,
        "avatars": RecipeParams,
        "methods": MethodParams,
        "scenes": SceneParams,
        "predeblur": PredeblurParams,
        "warmups": WarmupParams,
        "runs": RunParams,
        "animations": AnimationParams,
        "exports": ExportsParams,
    }
    section_of(content, path, "seed", int)
    section_of(content, path, "snapshots", int)
    section_of(content, path, "check", CheckParams)
    section_of(content, path, "from", PlacesParams)
    section_of(content, path, "reports", list[str])
    for name in set(section_of(content, path, "without_pictures", list[str])):
        if name not in section_of(content, path, "scenes", dict):
            raise ConfigError(f"{path}: without_pictures: there is no scene {name!r}")
    for section, kind in sections.items():
        for name in section_of(content, path, section, dict):
            section_of(content, path, f"{section}.{name}", kind)
    section_of(content, path, f"schedules.{section_of(content, path, 'schedule', str)}", dict)
    _check_scenes(content, path)
    _check_runs(content, path)


def _check_scenes(content: Mapping[str, Any], path: Path) -> None:
    for name in content["scenes"].keys() & METRICS_OF_STAGES:
        raise ConfigError(
            f"{path}: scenes.{name}: metrics/{name} is where a stage writes; give the scene "
            "another name"
        )
    checked = section_of(content, path, "checks", list[str])
    for section, names in (("predeblur", content["predeblur"]), ("checks", checked)):
        for name in set(names) - content["scenes"].keys():
            raise ConfigError(f"{path}: {section}: there is no scene {name!r}")


def _check_runs(content: Mapping[str, Any], path: Path) -> None:
    named = {"scene": "scenes", "avatar": "avatars", "method": "methods"}
    for section in ("warmups", "runs"):
        for name, entry in content[section].items():
            for key in named.keys() & entry.keys():
                if entry[key] not in content[named[key]]:
                    known = ", ".join(content[named[key]])
                    raise ConfigError(
                        f"{path}: {section}.{name}: no {key} {entry[key]!r}, there is {known}"
                    )
    for name, entry in content["runs"].items():
        warmup = f"{entry['scene']}-{entry['observations']}-{entry['avatar']}"
        if warmup not in content["warmups"]:
            raise ConfigError(f"{path}: runs.{name} goes on from {warmup}, add it to warmups")
    for section in ("learning_curves", "self_checks"):
        for name, entry in section_of(content, path, section, dict).items():
            if content["runs"].get(name) != entry:
                raise ConfigError(f"{path}: {section}.{name} is not as in runs")
    for section in ("animations", "exports"):
        for name, entry in content[section].items():
            if content["runs"].get(name, {}).get("scene") != entry["scene"]:
                raise ConfigError(
                    f"{path}: {section}.{name}: no run {name!r} on {entry['scene']!r}"
                )
