"""The code of docs/extending.md runs, and what it adds is found where it should be."""

import re
from pathlib import Path

import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.reading import parse, read_yaml
from deblur_avatar.evaluation import metrics
from deblur_avatar.evaluation.reblur import reblur
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.registry import EXPORTERS, ExportParams
from deblur_avatar.motion.kinds import KINDS
from deblur_avatar.pipeline.clip import ClipParams, load_clip
from deblur_avatar.pipeline.evaluate import evaluate
from deblur_avatar.pipeline.fusion import fuse
from deblur_avatar.pipeline.parameters import MethodParams
from deblur_avatar.pipeline.trajectory import fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.sources.registry import SOURCES
from tests.filmed_scene import Scene

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "extending.md").read_text()
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def shown() -> dict[str, object]:
    """What the guide's blocks define, run one after the other."""
    names: dict[str, object] = {"__name__": "extending"}
    for block in re.findall(r"```python\n(.*?)```", GUIDE, flags=re.S):
        exec(compile(block, "docs/extending.md", "exec"), names)
    return names


def test_the_table_names_what_there_is() -> None:
    for module, name in re.findall(r"`([a-z_/]+)\.py: ([A-Z_]+)`", GUIDE):
        path = ROOT / "deblur_avatar" / f"{module}.py"
        assert re.search(rf"^{name}\b", path.read_text(), flags=re.M), (module, name)


def test_the_trajectory_is_fitted_saved_and_evaluated(
    shown, make_observations, recipe, schedule, monkeypatch
) -> None:
    monkeypatch.setitem(KINDS, "spin", shown["SpinMotion"])
    section = read_yaml_block()["methods"]["spin"]
    method = parse(MethodParams, section, "methods.spin")
    seen = make_observations(frames=6)
    quiet = {"device": CPU, "generator": torch.Generator().manual_seed(0), "report": _quiet}
    avatar, checkpoint, _ = warm_up(seen, recipe, schedule, **quiet)
    avatar, motion, checkpoint, _ = fit_trajectory(
        seen, avatar, checkpoint, recipe, method.trajectory, schedule, **quiet
    )
    assert motion.kind == "spin"
    assert motion.u.tolist() == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9])
    avatar, refined, _ = fuse(
        seen,
        avatar,
        motion,
        checkpoint,
        recipe,
        method.trajectory.motion,
        method.fusion,
        schedule,
        **quiet,
    )
    assert not torch.equal(refined.parameters["spin"], motion.parameters["spin"])
    assert reblur(_model(avatar, seen), seen, refined)["psnr"] > 10


def test_the_source_is_loaded_by_name(shown, body: Body, monkeypatch) -> None:
    monkeypatch.setitem(SOURCES, "mirror", shown["MirrorParams"])
    studio = read_yaml(ROOT / "params.yaml")["scenes"]["studio"]["clip"]
    studio |= {
        "frames": 4, "image_size": 8, "test_cameras": 1, "test_stride": 2, "window": 3,
        "samples_per_axis": 1, "held_out": 0.25,
    }  # fmt: skip
    plain, mirrored = (
        load_clip(
            parse(ClipParams, section, "clip"),
            body, detect=_nobody, generator=torch.Generator().manual_seed(0),
        )[0]
        for section in (studio, {"source": "mirror", "studio": studio})
    )  # fmt: skip
    assert torch.equal(mirrored.frames, plain.frames.flip(3))


def test_the_metric_is_measured(shown, scene: Scene, monkeypatch) -> None:
    monkeypatch.setattr(metrics, "METRICS", (*metrics.METRICS, shown["BRIGHTNESS"]))
    measured = evaluate(scene.observations, scene.reference, scene.avatar, scene.motion, CPU)
    assert 0 <= measured.metrics["image"]["brightness_error"] < 0.1
    assert "brightness_error" in measured.metrics["recovery"]


def test_the_format_is_written_by_name(shown, scene: Scene, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(EXPORTERS, "xyz", shown["XyzExport"])
    exporter = parse(ExportParams, {"format": "xyz"}, "export")
    path = tmp_path / "lean.xyz"
    exporter.export(FittedRun(scene.avatar, scene.motion, scene.observations), path)
    rows = [list(map(float, line.split())) for line in path.read_text().splitlines()]
    torch.testing.assert_close(torch.tensor(rows), scene.avatar.means, atol=1e-6, rtol=0)


def read_yaml_block():
    from ruamel.yaml import YAML

    block = re.search(r"```yaml\n(.*?)```", GUIDE, flags=re.S)
    assert block
    return YAML(typ="safe").load(block[1])


def _quiet(iteration, terms) -> None:
    pass


def _nobody(frames):
    raise AssertionError("nobody is to be looked for")


def _model(avatar, seen):
    return avatar_from_artifact(avatar, seen.body, CPU)
