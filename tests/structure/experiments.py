"""Which experiments there are, and whether their pipelines are those of the root."""

from pathlib import Path

from deblur_avatar.config.reading import read_yaml
from deblur_avatar.pipeline.experiment import (
    PARAMS,
    PIPELINE,
    experiment_pipeline,
)

ROOT = Path(__file__).parents[2]
MAKER = "make deps"


def experiments(root: Path = ROOT) -> list[Path]:
    """The folders of all experiments: those whose parameters name a seed."""
    files = (root / "experiments").rglob(PARAMS)
    return sorted(path.parent for path in files if "seed" in read_yaml(path))


def pipeline(folder: Path, root: Path = ROOT) -> str:
    """What the `dvc.yaml` of an experiment must be."""
    return experiment_pipeline(folder, root, MAKER)


def write_pipelines(root: Path = ROOT) -> list[str]:
    """Bring every experiment's `dvc.yaml` up to date; returns those that changed."""
    changed = []
    for folder in experiments(root):
        path, text = folder / PIPELINE, pipeline(folder, root)
        if not path.is_file() or path.read_text() != text:
            path.write_text(text)
            changed.append(str(path.relative_to(root)))
    return changed
