"""Pipelines of experiments: the stages of dvc.yaml over the scenes of another parameter file.

DVC cannot include a pipeline in another. So that no stage is written twice by hand, the `dvc.yaml`
beside each `experiments/<name>/params.yaml` and `avatars/<name>/params.yaml` is made from the one
at the root: the same commands, run at the root, that write below that folder. Parameters come from
the folder's file; the sections it lacks come from the file that its `shared` names, and so on down
to the root's.

A folder may run some of the stages only (`stages` in its parameters); without `bodies` of its own
it does not run `body`. What the other stages make is then the root pipeline's. Folders may lie
deeper, one a seed, above parameters that the seeds share.
"""

import os
import re
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

PIPELINE, PARAMS = "dvc.yaml", "params.yaml"
FETCHED = {"schedule", "warmups", "runs"}  # sections that say what there is to run
HEADER = "# Made from {up}/dvc.yaml by `{maker}`; change that. What is run is in params.yaml.\n\n"


def experiment_pipeline(folder: Path, root: Path, maker: str) -> str:
    """What the `dvc.yaml` of an experiment must be; `maker` is the command that writes it."""
    content = _read(root / PIPELINE)
    layers = _layers(folder / PARAMS, root)
    name = str(folder.relative_to(root))
    up = "/".join([".."] * len(folder.relative_to(root).parts))
    given = next((sections["stages"] for _, sections in layers if "stages" in sections), None)
    bodies = "bodies" in layers[0][1]
    run = {stage for stage in content["stages"] if bodies or stage != "body"}
    run = run if given is None else set(given)
    written = _written({stage for stage in content["stages"] if stage not in run})

    def below(path: str) -> str:
        return written.sub(rf"{name}/\1", path)

    content["stages"] = {key: value for key, value in content["stages"].items() if key in run}
    for entry in content["stages"].values():
        stage = entry.get("do", entry)
        changed = {
            "wdir": up,
            "cmd": below(stage["cmd"]).replace(PARAMS, f"{name}/{PARAMS}"),
            "deps": [below(dep) for dep in stage["deps"]],
            "params": _params(stage["params"], layers),
            "outs": [_output(out, below) for out in stage["outs"]],
        }
        stage.update(changed)
    if "report" not in run:
        for section in ("metrics", "plots"):
            content.pop(section, None)
    fetched = _fetched(folder, root, layers)
    content = {"vars": fetched, **content} if fetched else content
    return HEADER.format(up=up, maker=maker) + _text(content)


def _read(path: Path) -> Any:
    return YAML(typ="safe", pure=True).load(path)


def _layers(path: Path, root: Path) -> list[tuple[str, dict[str, Any]]]:
    """A folder's parameter files, each with what it says, from its own to the root's."""
    content = _read(path)
    below = [] if "shared" not in content else _layers(path.parent / content["shared"], root)
    return [(os.path.relpath(path, root), content), *below]


def _fetched(folder: Path, root: Path, layers: list[tuple[str, dict[str, Any]]]) -> list[str]:
    """Sections that DVC has to read from files further down, in its notation."""
    known = set(layers[0][1])
    found = []
    for path, content in layers[1:]:
        keys = sorted((FETCHED & set(content)) - known)
        known |= set(keys)
        if keys:
            found.append(f"{os.path.relpath(root / path, folder)}:{','.join(keys)}")
    return found


def _written(foreign: set[str]) -> re.Pattern[str]:
    """Folders (not options) that are written here, which are not those of foreign stages."""
    data = rf"data(?!/(?:{'|'.join(sorted(foreign))})\b)" if foreign else "data"
    return re.compile(rf"(?<![\w/.-])({data}|metrics|reports)(?=[/\s]|$)")


def _params(keys: list[str], layers: list[tuple[str, dict[str, Any]]]) -> list[Any]:
    rest = list(keys)
    declared: list[Any] = []
    for path, content in layers:
        own = [key for key in rest if key.split(".")[0] in content]
        rest = [key for key in rest if key not in own]
        declared += own if path == PARAMS else [{path: own}] if own else []
    return [*declared, *rest]


def _output(out: Any, below: Callable[[str], str]) -> Any:
    if isinstance(out, dict):
        return {below(path): options for path, options in out.items()}
    return below(out)


def _text(content: Any) -> str:
    yaml = YAML()
    yaml.width = 100
    yaml.indent(mapping=2, sequence=4, offset=2)
    stream = StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()
