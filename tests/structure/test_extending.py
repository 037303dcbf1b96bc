"""The code of docs/extending.md runs, and what it adds is found where it should be."""

import re
from pathlib import Path

import pytest
import torch
from ruamel.yaml import YAML

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.kinds import AVATARS, avatar_from_artifact
from deblur_avatar.config.reading import parse, read_yaml
from deblur_avatar.errors import ConfigError
from deblur_avatar.evaluation import metrics
from deblur_avatar.evaluation.reblur import reblur
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.ply import PlyExport
from deblur_avatar.exports.registry import EXPORTERS, ExportParams
from deblur_avatar.imaging.deblurring.kinds import DEBLURRERS
from deblur_avatar.library import animate
from deblur_avatar.methods import MethodParams
from deblur_avatar.motion.kinds import KINDS
from deblur_avatar.pipeline.clip import ClipParams, load_clip
from deblur_avatar.pipeline.evaluate import evaluate
from deblur_avatar.pipeline.fusion import fuse
from deblur_avatar.pipeline.predeblur import PredeblurParams, predeblur
from deblur_avatar.pipeline.trajectory import fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.sources.registry import SOURCES
from deblur_avatar.training.losses import LOSSES
from deblur_avatar.training.params import RecipeParams
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
    section = read_yaml_blocks()["methods"]["spin"]
    method = parse(MethodParams, section, "methods.spin")
    seen = make_observations(frames=6)
    torch.manual_seed(3)  # networks start from it
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


def test_the_loss_is_a_term_with_its_weight(
    shown, observations, tiny_content, schedule, monkeypatch
) -> None:
    monkeypatch.setitem(LOSSES, "level", shown["LEVEL"])
    content = tiny_content["avatars"]["lean"]
    with pytest.raises(ConfigError, match="missing key 'losses.level'"):
        parse(RecipeParams, content, "avatars.lean")
    content["losses"]["level"] = 0.1
    heard: list[dict[str, float]] = []
    warm_up(
        observations, parse(RecipeParams, content, "avatars.lean"), schedule, device=CPU,
        generator=torch.Generator().manual_seed(0),
        report=lambda _, terms: heard.append(dict(terms)),
    )  # fmt: skip
    assert all(0 < terms["level"] < 0.1 for terms in heard)


@pytest.mark.parametrize("name", ["paper", "lean"])
def test_the_avatar_is_fitted_saved_evaluated_and_animated(
    shown, scene: Scene, tiny_content, schedule, monkeypatch, tmp_path: Path, name
) -> None:
    monkeypatch.setitem(AVATARS, "balls", shown["BallAvatar"])
    recipe = parse(RecipeParams, read_yaml_blocks()["avatars"]["balls"], "avatars.balls")
    method = parse(MethodParams, tiny_content["methods"][name], f"methods.{name}")
    seen = scene.observations
    shared = {"device": CPU, "generator": torch.Generator().manual_seed(0), "report": _quiet}
    first, checkpoint, _ = warm_up(seen, recipe, schedule, **shared)
    avatar, motion, checkpoint, _ = fit_trajectory(
        seen, first, checkpoint, recipe, method.trajectory, schedule, **shared
    )
    avatar, motion, cost = fuse(
        seen, avatar, motion, checkpoint, recipe, method.trajectory.motion, method.fusion,
        schedule, **shared,
    )  # fmt: skip
    assert cost["gaussians"] == 0
    avatar.save(tmp_path / "avatar")
    assert not torch.equal(first.networks["colors"], avatar.networks["colors"])
    model = avatar_from_artifact(Avatar.load(tmp_path / "avatar"), seen.body, CPU)
    assert torch.equal(model.colors, avatar.networks["colors"])
    measured = evaluate(seen, scene.reference, avatar, motion, CPU)
    assert measured.metrics["image"]["psnr"] > 10
    assert measured.metrics["model"]["parts"] == ["avatar:balls", f"motion:{motion.kind}"]
    frames = animate(model, "builtin:jumping_jacks", seconds=0.1, size=16)
    assert frames.float().std() > 0
    with pytest.raises(ConfigError, match="kind balls is no set of Gaussians"):
        PlyExport(format="ply", frame=0).export(
            FittedRun("run", avatar, motion, seen), tmp_path / "x"
        )


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


def test_the_deblurrer_is_found_by_name(shown, observations, monkeypatch) -> None:
    monkeypatch.setitem(DEBLURRERS, "unsharp", shown["UnsharpParams"])
    section = {"given": "", "deblurrer": {"kind": "unsharp", "share": 0.5}}
    params = parse(PredeblurParams, section, "predeblur.here")
    made, used = predeblur(observations, params)
    assert used == {"method": "unsharp", "share": 0.5}
    assert made.frames.shape == observations.frames.shape
    assert made.frames.float().std() > observations.frames.float().std()
    assert made.mattes.float().std() > observations.mattes.float().std()


def test_the_metric_is_measured(shown, scene: Scene, monkeypatch) -> None:
    monkeypatch.setattr(metrics, "METRICS", (*metrics.METRICS, shown["BRIGHTNESS"]))
    measured = evaluate(scene.observations, scene.reference, scene.avatar, scene.motion, CPU)
    assert 0 <= measured.metrics["image"]["brightness_error"] < 0.1
    assert "brightness_error" in measured.metrics["recovery"]


def test_the_format_is_written_by_name(shown, scene: Scene, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(EXPORTERS, "xyz", shown["XyzExport"])
    exporter = parse(ExportParams, {"format": "xyz"}, "export")
    path = tmp_path / "lean.xyz"
    exporter.export(FittedRun("run", scene.avatar, scene.motion, scene.observations), path)
    rows = [list(map(float, line.split())) for line in path.read_text().splitlines()]
    torch.testing.assert_close(torch.tensor(rows), scene.avatar.means, atol=1e-6, rtol=0)


def read_yaml_blocks():
    blocks = re.findall(r"```yaml\n(.*?)```", GUIDE, flags=re.S)
    return YAML(typ="safe").load("\n".join(blocks))


def _quiet(iteration, terms) -> None:
    pass


def _nobody(frames):
    raise AssertionError("nobody is to be looked for")


def _model(avatar, seen):
    return avatar_from_artifact(avatar, seen.body, CPU)
