"""Pipelines of experiments: the stages of dvc.yaml over the scenes of another parameter file.

DVC cannot include a pipeline in another. So that no stage is written twice by hand, the `dvc.yaml`
beside each `experiments/<name>/params.yaml` and `avatars/<name>/params.yaml` is made from the one
at the root: the same commands, run at the root, that write below that folder. Parameters come from
the folder's file; the sections it lacks come from the root's. Without `bodies` of its own a folder
uses the root's, which then need not be baked again.
"""

import re
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

PIPELINE, PARAMS = "dvc.yaml", "params.yaml"
WRITTEN = re.compile(r"(?<![\w/.-])(data|metrics|reports)(?=[/\s]|$)")  # folders, not options
OF_ROOT = re.compile(r"(?<![\w/.-])(data(?!/body)|metrics|reports)(?=[/\s]|$)")
HEADER = "# Made from ../../dvc.yaml by `{maker}`; change that. What is run is in params.yaml.\n\n"


def experiment_pipeline(folder: Path, root: Path, maker: str) -> str:
    """What the `dvc.yaml` of an experiment must be; `maker` is the command that writes it."""
    content = YAML(typ="safe", pure=True).load(root / PIPELINE)
    sections = YAML(typ="safe", pure=True).load(folder / PARAMS)
    name = str(folder.relative_to(root))
    written = WRITTEN
    if "bodies" not in sections:
        content["stages"].pop("body", None)
        written = OF_ROOT

    def below(path: str) -> str:
        return written.sub(rf"{name}/\1", path)

    for entry in content["stages"].values():
        stage = entry.get("do", entry)
        changed = {
            "wdir": "/".join([".."] * len(folder.relative_to(root).parts)),
            "cmd": below(stage["cmd"]).replace(PARAMS, f"{name}/{PARAMS}"),
            "deps": [below(dep) for dep in stage["deps"]],
            "params": _params(stage["params"], sections, name),
            "outs": [_output(out, below) for out in stage["outs"]],
        }
        stage.update(changed)
    return HEADER.format(maker=maker) + _text(content)


def _params(keys: list[str], sections: dict[str, Any], name: str) -> list[Any]:
    own = [key for key in keys if key.split(".")[0] in sections]
    shared = [key for key in keys if key not in own]
    return [*([{f"{name}/{PARAMS}": own}] if own else []), *shared]


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
