"""What the pipelines of this repository say, as tests ask for it."""

import copy
from functools import cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from deblur_avatar.pipeline.code import pipelines

ROOT = Path(__file__).parents[2]
PARAMS, PIPELINE = "params.yaml", "dvc.yaml"


def read(path: Path) -> Any:
    """A YAML file as DVC reads it."""
    return copy.deepcopy(_parsed(path.read_text()))


@cache
def _parsed(text: str) -> Any:
    """Once for all files of these words: a pipeline takes a second, and experiments have copies."""
    return YAML(typ="safe", pure=True).load(text)


def stages(path: Path = ROOT / PIPELINE) -> dict[str, Any]:
    """The stages of a pipeline by name, without their `foreach`."""
    return {name: stage.get("do", stage) for name, stage in read(path)["stages"].items()}


def experiments() -> list[Path]:
    """The folders of experiments that run the root's stages."""
    return [folder for folder in pipelines(ROOT) if folder.is_relative_to(ROOT / "experiments")]


def gathering() -> list[Path]:
    """Pipelines with stages of their own: of the ablations' tables, the stress suite, the proof,
    the deblurring network's weights.
    """
    suite = sorted(
        ROOT / "stability" / name / PIPELINE for name in ("", "agnostic", "cases", "lean", "paper")
    )
    proof = sorted((ROOT / "experiments/proof").rglob(PIPELINE))
    alone = [ROOT / "experiments" / name / PIPELINE for name in ("ablations", "dstnet")]
    return [*alone, *suite, *proof]


def script_of(stage: dict[str, Any]) -> Path:
    """The script that a stage's command runs, as a file or as a module."""
    words = str(stage["cmd"]).split()
    if words[1] == "-m":
        return ROOT.joinpath(*words[2].split(".")).with_suffix(".py")
    return ROOT / words[1].removeprefix("${from.root}/")


def options_of(stage: dict[str, Any]) -> dict[str, str]:
    """What the command gives to each option of the script."""
    words = str(stage["cmd"]).split()
    return {
        word.removeprefix("--").replace("-", "_"): value
        for word, value in zip(words, words[1:], strict=False)
        if word.startswith("--")
    }


def paths_in(stage: dict[str, Any], kind: str) -> list[str]:
    """Dependencies or outputs as plain strings."""
    return [
        next(iter(item)) if isinstance(item, dict) else str(item) for item in stage.get(kind, [])
    ]


def params_of(stage: dict[str, Any]) -> dict[str, list[str]]:
    """What a stage depends on of each file of parameters."""
    found: dict[str, list[str]] = {}
    for entry in stage.get("params", []):
        for file, keys in entry.items():
            found.setdefault(file, []).extend(map(str, keys))
    return found
