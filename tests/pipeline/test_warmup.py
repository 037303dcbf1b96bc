from types import SimpleNamespace

import pytest
import torch

from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.networks_avatar import NetworksAvatar
from deblur_avatar.pipeline.warmup import warm_up
from tests.changed_parameters import changed

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")


def quiet(iteration, terms):
    pass


@pytest.fixture
def warm(observations, recipe, schedule):
    def run(params=recipe, seen=observations, seed=0, report=quiet):
        torch.manual_seed(seed)
        generator = torch.Generator().manual_seed(seed)
        return warm_up(seen, params, schedule, device=CPU, generator=generator, report=report)

    return run


def test_a_warm_up_makes_an_avatar_its_memory_and_its_cost(warm, recipe, schedule, observations):
    iterations = []
    avatar, checkpoint, cost = warm(report=lambda iteration, _: iterations.append(iteration))
    assert iterations == list(range(1, schedule.warmup + 1))
    assert avatar.iteration == checkpoint.iteration == schedule.warmup
    assert cost["gaussians"] == len(avatar.means)
    assert 0 < cost["seconds"] < 60
    assert cost["precision"].startswith("bfloat16, ")
    assert cost["cpu"] == torch.backends.cpu.get_cpu_capability()
    assert avatar.model["frames"] == len(observations.frames)
    assert avatar.model["light"] == observations.averaging_space
    assert torch.equal(avatar.betas, observations.poses.betas)
    model = avatar_from_artifact(avatar, observations.body, CPU)
    assert model.params == recipe.model


def test_the_first_gaussians_are_as_many_as_the_schedule_says_and_drawn_from_the_generator(
    warm, recipe, schedule, observations
):
    never = {"start": 15_000, "stop": 15_000}
    still = changed(recipe, "fitting.densify", **never)
    still = changed(still, "fitting", gaussians_start=15_000)
    avatar, checkpoint, _ = warm(still, seed=5)
    assert len(avatar.means) == schedule.gaussians
    assert checkpoint.tensors["densifier.first_count"].item() == schedule.gaussians
    drawn = NetworksAvatar.create(
        recipe.model, observations.body, observations.poses.betas, 5, schedule.gaussians, "srgb",
        torch.Generator().manual_seed(5),
    )  # fmt: skip
    assert torch.equal(avatar.means, drawn.gaussians.means)


def test_a_warm_up_knows_no_motion(warm):
    _, checkpoint, _ = warm()
    names = set(checkpoint.tensors)
    assert not any(name.startswith("networks.motion") for name in names)
    assert any(name.startswith("networks.network.color") for name in names)
    assert any(name.startswith("gaussians.means") for name in names)


def test_blur_or_no_blur_makes_no_difference_to_the_recipe(warm, sharpened):
    short, long = (warm(seen=sharpened(exposure=value))[0] for value in (None, 0.1))
    assert torch.equal(short.means, long.means)


def test_equal_seeds_make_equal_files(warm, tmp_path):
    for name, seed in (("one", 1), ("same", 1), ("other", 2)):
        avatar, checkpoint, _ = warm(seed=seed)
        avatar.save(tmp_path / name / "avatar")
        checkpoint.save(tmp_path / name / "checkpoint")
    for part in ("avatar", "checkpoint"):
        one, same, other = (
            (tmp_path / name / part / "tensors.safetensors").read_bytes()
            for name in ("one", "same", "other")
        )
        assert one == same
        assert one != other


def test_pretraining_can_be_left_out(warm, recipe):
    params = changed(recipe, "model.skinning", pretrain=0)
    (with_it, _, _), (without, _, _) = warm(), warm(params)
    assert not torch.equal(
        with_it.networks["skinning.network.last.weight"],
        without.networks["skinning.network.last.weight"],
    )


def test_what_is_seen_too_little_begins_anew_once_warm(warm, recipe, observations, monkeypatch):
    asked = []

    def inpaint(self, fitting, seen, centre, *, finished):
        asked.append((fitting is recipe.fitting, seen is observations, finished))
        torch.testing.assert_close(centre.transl, observations.poses.transl)
        with torch.no_grad():
            self.gaussians.features.fill_(0.25)

    monkeypatch.setattr(NetworksAvatar, "inpaint", inpaint)
    clock = iter([0.0, 0.0, 0.0, 1000.0])  # before fitting, twice, and before and after this
    watch = SimpleNamespace(perf_counter=lambda: next(clock))
    monkeypatch.setattr("deblur_avatar.pipeline.warmup.time", watch)
    avatar, _, cost = warm()
    assert 1000 < cost["seconds"] < 1060
    assert asked == [(True, True, False)]
    assert (avatar.features == 0.25).all()
