"""Pipelines of experiments: the stages of dvc.yaml over the scenes of another parameter file.

DVC cannot include a pipeline in another. So that no stage is written twice by hand, the `dvc.yaml`
beside each `experiments/<name>/params.yaml` is made from the one at the root: the same commands,
run at the root, that write below `experiments/<name>`. Parameters come from the experiment's file;
the sections it lacks come from the root's.
"""

import re
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
PIPELINE, PARAMS = "dvc.yaml", "params.yaml"
WRITTEN = re.compile(r"(?<![\w/.-])(data|metrics|reports)(?=[/\s]|$)")  # folders, not options
HEADER = (
    "# Made from ../../dvc.yaml by `make deps`; change that. What is run is in params.yaml.\n\n"
)


def experiments(root: Path = ROOT) -> list[Path]:
    """The folders of all experiments."""
    return sorted(path.parent for path in (root / "experiments").glob(f"*/{PARAMS}"))


def pipeline(folder: Path, root: Path = ROOT) -> str:
    """What the `dvc.yaml` of an experiment must be."""
    content = YAML(typ="safe", pure=True).load(root / PIPELINE)
    sections = YAML(typ="safe", pure=True).load(folder / PARAMS)
    name = str(folder.relative_to(root))
    for entry in content["stages"].values():
        stage = entry.get("do", entry)
        up = "/".join([".."] * len(folder.relative_to(root).parts))
        cmd = WRITTEN.sub(rf"{name}/\1", stage["cmd"]).replace(PARAMS, f"{name}/{PARAMS}")
        changed = {
            "wdir": up,
            "cmd": cmd,
            "deps": [WRITTEN.sub(rf"{name}/\1", dep) for dep in stage["deps"]],
            "params": _params(stage["params"], sections, name),
            "outs": [_output(out, name) for out in stage["outs"]],
        }
        stage.update(changed)
    return HEADER + _text(content)


def write_pipelines(root: Path = ROOT) -> list[str]:
    """Bring every experiment's `dvc.yaml` up to date; returns those that changed."""
    changed = []
    for folder in experiments(root):
        path, text = folder / PIPELINE, pipeline(folder, root)
        if not path.is_file() or path.read_text() != text:
            path.write_text(text)
            changed.append(str(path.relative_to(root)))
    return changed


def _params(keys: list[str], sections: dict[str, Any], name: str) -> list[Any]:
    own = [key for key in keys if key.split(".")[0] in sections]
    shared = [key for key in keys if key not in own]
    return [*([{f"{name}/{PARAMS}": own}] if own else []), *shared]


def _output(out: Any, name: str) -> Any:
    if isinstance(out, dict):
        return {WRITTEN.sub(rf"{name}/\1", path): options for path, options in out.items()}
    return WRITTEN.sub(rf"{name}/\1", out)


def _text(content: Any) -> str:
    yaml = YAML()
    yaml.width = 100
    yaml.indent(mapping=2, sequence=4, offset=2)
    stream = StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()
