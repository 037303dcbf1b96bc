"""Run the whole pipeline as far as this machine has the footage.

Scenes whose files are missing are named and left out, and those that take long (`on_request`) wait
to be asked for; everything else is reproduced, and the report is written over all results.
"""

import argparse
import logging
from collections.abc import Collection, Sequence
from pathlib import Path

from deblur_avatar.cli.report import show_report
from deblur_avatar.cli.running_dvc import check_checkout, reproduce
from deblur_avatar.config.reading import load_params, read_yaml
from deblur_avatar.errors import ConfigError
from deblur_avatar.parameters import SceneParams, check_parameters
from deblur_avatar.pipeline.body import BodyParams

logger = logging.getLogger(__name__)

PARAMS = Path("params.yaml")


def missing_footage(params_file: Path) -> dict[str, str]:
    """Scenes that cannot be made here, each with the reason.

    Raises:
        ConfigError: if the parameter file cannot be run at all.
    """
    check_parameters(params_file)
    missing = {}
    for scene in load_params(params_file, "scenes", dict):
        params = load_params(params_file, f"scenes.{scene}", SceneParams)
        body = load_params(params_file, f"bodies.{params.body}", BodyParams)
        reasons = params.clip.missing_files(f"scenes.{scene}.clip")
        reasons += body.missing_files(f"bodies.{params.body}")
        if reasons:
            missing[scene] = "; ".join(reasons)
    return missing


def not_asked_for(params_file: Path, asked: Sequence[str]) -> dict[str, str]:
    """Scenes to leave out, each with the reason: those on request, or all but those asked for.

    Raises:
        ConfigError: if a scene asked for, or said to be on request, is not there.
    """
    scenes = load_params(params_file, "scenes", dict)
    on_request = load_params(params_file, "on_request", list[str])
    for name in [*asked, *on_request]:
        if name not in scenes:
            raise ConfigError(f"no scene {name!r}, there is {', '.join(scenes)}")
    if asked:
        return {name: "it was not asked for" for name in scenes if name not in asked}
    return {name: f"it takes long; --scenes {name} makes it" for name in on_request}


def targets(params_file: Path, missing: Collection[str]) -> list[str]:
    """What to ask DVC for: nothing (all of it), or the last stages of scenes that are made."""
    if not missing:
        return []
    content = read_yaml(params_file)
    runs = content["runs"]
    kept = [name for name, run in runs.items() if run["scene"] not in missing]
    sections = {  # of runs, by the stage that goes through them
        "self_check": "self_checks", "evaluate": "runs", "learning_curve": "learning_curves",
        "animate": "animations", "export": "exports",
    }  # fmt: skip
    scenes = dict.fromkeys(runs[name]["scene"] for name in kept)
    return [
        *(f"{stage}@{scene}" for scene in scenes for stage in ("score_blur", "check")),
        *(f"score_predeblur@{scene}" for scene in content["predeblur"] if scene in scenes),
        *(
            f"{stage}@{name}"
            for stage, section in sections.items()
            for name in content[section]
            if name in kept
        ),
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument(
        "--scenes", nargs="+", default=[], help="of params.yaml; default: all but those on request"
    )


def run(asked: argparse.Namespace) -> int:
    """Reproduce, then write and print the report's table; returns DVC's exit code.

    Raises:
        ConfigError: if the parameters cannot be run, or no scene is left to make.
    """
    check_checkout(Path())
    missing = not_asked_for(PARAMS, asked.scenes) | missing_footage(PARAMS)
    for scene, reason in missing.items():
        logger.warning("scene %s is left out: %s", scene, reason)
    wanted = targets(PARAMS, missing)
    if missing and not wanted:  # to DVC no target is all of them
        why = "; ".join(f"{scene}: {missing[scene]}" for scene in asked.scenes if scene in missing)
        raise ConfigError(
            f"nothing of {', '.join(asked.scenes) or PARAMS} can be made here: "
            f"{why or 'each of its scenes is left out, or no run is of it'}"
        )
    code = reproduce(wanted, *([["--single-item", "report"]] if wanted else []))
    return code or show_report()
