"""Avatars and motions are chosen apart: each of the one is fitted with each of the other."""

import copy

import pytest
import torch

from deblur_avatar.avatars.kinds import AVATARS, avatar_from_artifact
from deblur_avatar.avatars.one_sided_avatar import OneSidedAvatar
from deblur_avatar.avatars.plain_avatar import PlainAvatar
from deblur_avatar.config.reading import parse
from deblur_avatar.evaluation.reblur import reblur
from deblur_avatar.motion.kinds import KINDS
from deblur_avatar.pipeline.fusion import UnfusedParams, fuse
from deblur_avatar.pipeline.trajectory import TrajectoryParams, fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams

CPU = torch.device("cpu")


def quiet(iteration, terms):
    pass


def generator():
    return torch.Generator().manual_seed(0)


@pytest.fixture(scope="module")
def few(make_observations):
    """Three frames: two that are fitted, and the one after them."""
    return make_observations(frames=3, size=16)


@pytest.fixture(scope="module")
def schedule(tiny_parameters):
    ends = {"warmup": 1, "trajectory": 2, "fusion": 3, "image_height": 16}
    return parse(ScheduleParams, tiny_parameters["schedules"]["tiny"] | ends, "schedules.tiny")


def recipe_of(avatar, tiny_parameters):
    """Of a kind of avatar; volumes have few samples along a ray and narrow networks."""
    content = copy.deepcopy(tiny_parameters["avatars"])
    surface = content["arah_small"]
    surface["model"]["samples"] |= {"near": 5, "front": 3, "free": 6}
    surface["model"]["sdf"]["hidden"] = [32, 32, 32]
    surface["model"]["skinning"]["hidden"] = [16, 16]
    surface["fitting"]["rays"]["patches"] = 60
    volume = content["humannerf_small"]
    volume["model"]["samples"] = 16
    volume["model"]["field"]["hidden"] = [32, 32]
    volume["model"]["nonrigid"]["hidden"] = [16, 16]
    volume["fitting"]["rays"]["size"] = 8
    recipe = next(recipe for recipe in content.values() if recipe["model"]["kind"] == avatar)
    return parse(RecipeParams, recipe, "recipe")


def motion_of(kind, tiny_parameters):
    """A trajectory's parameters, of a kind, with few instants."""
    methods = tiny_parameters["methods"].values()
    motions = [method["trajectory"]["motion"] for method in methods]
    section = next(section for section in motions if section["kind"] == kind)
    if "virtual_poses" in section:
        section = section | {"virtual_poses": 3}
    content = {"motion": section, "supervision": "mean", "mask": "mean"}
    return parse(TrajectoryParams, content, "trajectory")


def warm(recipe, few, schedule, device=CPU, report=quiet):
    torch.manual_seed(0)
    fitted, checkpoint, _ = warm_up(
        few, recipe, schedule, device=device, generator=generator(), report=report
    )
    return recipe, fitted, checkpoint


def go_on(warmed, motion, few, schedule, device=CPU, report=quiet):
    recipe, fitted, checkpoint = warmed
    torch.manual_seed(0)
    shared = {"device": device, "generator": generator(), "report": report}
    fitted, found, checkpoint, _ = fit_trajectory(
        few, fitted, checkpoint, recipe, motion, schedule, **shared
    )
    unfused = UnfusedParams(supervision="mean", mask="mean")
    fitted, found, _ = fuse(
        few, fitted, found, checkpoint, recipe, motion.motion, unfused, schedule, **shared
    )
    return fitted, found


@pytest.fixture(scope="module", params=AVATARS)
def warmed(request, few, schedule, tiny_parameters):
    """An avatar before any motion: its recipe, and what the next stage reads; nobody changes it."""
    return warm(recipe_of(request.param, tiny_parameters), few, schedule)


@pytest.mark.parametrize("motion", KINDS)
def test_any_avatar_is_fitted_with_any_motion(motion, warmed, few, schedule, tiny_parameters):
    fitted, found = go_on(warmed, motion_of(motion, tiny_parameters), few, schedule)
    assert found.kind == motion
    model = avatar_from_artifact(fitted, few.body, CPU)
    assert model.kind == warmed[0].model.kind
    assert reblur(model, few, found)["psnr_train"] > 5


def test_a_one_sided_avatar_free_to_stand_off_is_a_plain_one_but_for_colours_no_frame_shows(
    few, schedule, tiny_parameters, monkeypatch
):
    """And but for its surface, and what begins anew once warm; both are let alone here."""
    inpaint = OneSidedAvatar.inpaint

    def once_finished(*arguments, finished):
        if finished:
            inpaint(*arguments, finished=True)

    monkeypatch.setattr(OneSidedAvatar, "inpaint", once_finished)
    monkeypatch.setattr(OneSidedAvatar, "closed_nearer", {})
    monkeypatch.setattr(OneSidedAvatar, "_open_share", PlainAvatar._open_share)
    motion, made, free = motion_of("clip", tiny_parameters), {}, copy.deepcopy(tiny_parameters)
    fitting = free["avatars"]["one_sided"]["fitting"]
    fitting |= {"least_pixels": 0.2, "sure_pixels": 0.2}
    fitting["regularisers"] |= {"near_body": 0.0, "opaque": 0.0}
    for kind in ("plain", "one_sided"):
        warmed = warm(recipe_of(kind, free), few, schedule)
        made[kind] = go_on(warmed, motion, few, schedule)[0]
    plain, one_sided = made["plain"], made["one_sided"]
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        assert torch.equal(getattr(one_sided, name), getattr(plain, name)), name
    other = (one_sided.features != plain.features).any(-1)
    assert 0.2 < other.float().mean() < 0.9
    # The one camera stands ahead; what it sees well is ahead, too.
    assert one_sided.means[~other, 2].mean() > one_sided.means[other, 2].mean() + 0.03


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
@pytest.mark.parametrize("motion", KINDS)
@pytest.mark.parametrize("avatar", AVATARS)
def test_a_fit_on_a_gpu_follows_that_on_the_cpu(
    avatar, motion, few, schedule, tiny_parameters, monkeypatch
):
    """It draws the same numbers, so that its losses are the same but for rounding."""
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)  # as a stage does
    recipe, moves = recipe_of(avatar, tiny_parameters), motion_of(motion, tiny_parameters)
    losses = {}
    for device in (CPU, torch.device("cuda")):
        seen = losses[device.type] = []
        place = {"device": device, "report": lambda _, terms, seen=seen: seen.append(dict(terms))}
        go_on(warm(recipe, few, schedule, **place), moves, few, schedule, **place)
    for here, there in zip(losses["cpu"], losses["cuda"], strict=True):
        assert there == pytest.approx(here, rel=0.05, abs=1e-5)
