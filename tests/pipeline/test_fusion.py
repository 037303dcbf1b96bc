from types import SimpleNamespace

import pytest
import torch

from deblur_avatar.avatars.networks_avatar import NetworksAvatar
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.fusion import FusionParams, fuse
from deblur_avatar.pipeline.trajectory import TrajectoryParams, fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")


def quiet(iteration, terms):
    pass


@pytest.fixture
def fused(observations, recipe, schedule, tiny_content):
    """A whole run of a method, its last stage with changes."""

    def run(method="paper", params=recipe, report=quiet, **changes):
        torch.manual_seed(0)
        generator = torch.Generator().manual_seed(0)
        shared = {"device": CPU, "generator": generator}
        section = tiny_content["methods"][method]
        trajectory = parse(TrajectoryParams, section["trajectory"], "trajectory")
        content = section["fusion"] | changes
        if content["supervision"] in ("sharp", "mean"):
            content.pop("network", None)
        fusion = parse(FusionParams, content, "fusion")
        avatar, checkpoint, _ = warm_up(observations, params, schedule, report=quiet, **shared)
        handed = fit_trajectory(
            observations, avatar, checkpoint, params, trajectory, schedule, report=quiet, **shared
        )
        result = fuse(
            observations, *handed[:3], params, trajectory.motion, fusion, schedule, report=report,
            **shared,
        )  # fmt: skip
        return handed, result

    return run


def test_fusion_finishes_the_avatar_and_its_motion(fused, schedule):
    iterations = []
    (_, before, _, _), (avatar, motion, cost) = fused(
        report=lambda iteration, _: iterations.append(iteration)
    )
    assert iterations == list(range(schedule.trajectory + 1, schedule.fusion + 1))
    assert avatar.iteration == schedule.fusion
    assert motion.kind == "pair"
    assert torch.equal(motion.u, before.u)
    assert not torch.equal(motion.parameters["start"], before.parameters["start"])
    assert cost["gaussians"] == len(avatar.means)
    assert cost["seconds"] > 0


def test_the_fusion_network_is_not_part_of_the_avatar(fused):
    (before, _, _, _), (after, _, _) = fused()
    assert after.networks.keys() == before.networks.keys()


def test_supervision_decides_what_is_learned(fused):
    # The same run up to here, the same draws in the last stage.
    results = {name: fused(supervision=name)[1][0].means for name in ("sharp", "mean", "fused")}
    for one, other in (("sharp", "mean"), ("mean", "fused"), ("sharp", "fused")):
        assert results[one].shape != results[other].shape or not torch.equal(
            results[one], results[other]
        )


def test_a_method_without_fusion_goes_on_as_before(fused):
    _, (_, motion, _) = fused("agnostic")
    assert motion.kind == "frame"


def test_equal_seeds_make_equal_avatars(fused):
    (_, (one, _, _)), (_, (same, _, _)) = fused(), fused()
    assert torch.equal(one.means, same.means)
    assert all(torch.equal(one.networks[name], same.networks[name]) for name in one.networks)


def test_there_is_a_fusion_network_if_and_only_if_renders_are_fused(tiny_content):
    section = tiny_content["methods"]["paper"]["fusion"]
    for supervision in ("fused", "released"):
        bare = {"supervision": supervision, "mask": "mean"}
        with pytest.raises(
            ConfigError, match="missing key 'fused.network'|missing key 'released.n"
        ):
            parse(FusionParams, bare, "fusion")
    for supervision in ("sharp", "mean"):
        with pytest.raises(ConfigError, match=f"unknown key '{supervision}.network'"):
            parse(FusionParams, section | {"supervision": supervision}, "fusion")


def test_an_avatar_without_a_pose_code_is_fused_by_what_is_seen(fused, plain_recipe):
    _, (avatar, _, _) = fused(params=plain_recipe)
    assert avatar.means.isfinite().all()


def test_colours_are_filled_in_once_warm_and_once_finished(fused, monkeypatch):
    asked = []

    def inpaint(self, fitting, seen, centre, *, finished):
        asked.append(finished)
        with torch.no_grad():
            self.gaussians.features.fill_(0.25)

    monkeypatch.setattr(NetworksAvatar, "inpaint", inpaint)
    clock = iter([0.0, 1000.0])
    watch = SimpleNamespace(perf_counter=lambda: next(clock))
    monkeypatch.setattr("deblur_avatar.pipeline.fusion.time", watch)
    _, (avatar, _, cost) = fused()
    assert 1000 < cost["seconds"] < 1060
    assert asked == [False, True]
    assert (avatar.features == 0.25).all()
