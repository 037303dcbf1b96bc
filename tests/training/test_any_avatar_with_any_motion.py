"""Avatars and motions are chosen apart: each of the one is fitted with each of the other."""

import copy

import pytest
import torch

from deblur_avatar.avatars.kinds import AVATARS, avatar_from_artifact
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


@pytest.fixture(scope="module", params=AVATARS)
def warmed(request, few, schedule, tiny_parameters):
    """An avatar before any motion: its recipe, and what the next stage reads; nobody changes it."""
    recipe = recipe_of(request.param, tiny_parameters)
    torch.manual_seed(0)
    fitted, checkpoint, _ = warm_up(
        few, recipe, schedule, device=CPU, generator=generator(), report=quiet
    )
    return recipe, fitted, checkpoint


@pytest.mark.parametrize("motion", KINDS)
def test_any_avatar_is_fitted_with_any_motion(motion, warmed, few, schedule, tiny_parameters):
    recipe, fitted, checkpoint = warmed
    methods = tiny_parameters["methods"].values()
    motions = [method["trajectory"]["motion"] for method in methods]
    section = next(section for section in motions if section["kind"] == motion)
    if "virtual_poses" in section:
        section = section | {"virtual_poses": 3}
    content = {"motion": section, "supervision": "mean", "mask": "mean"}
    moves = parse(TrajectoryParams, content, "trajectory")
    torch.manual_seed(0)
    shared = {"device": CPU, "generator": generator(), "report": quiet}
    fitted, found, checkpoint, _ = fit_trajectory(
        few, fitted, checkpoint, recipe, moves, schedule, **shared
    )
    unfused = UnfusedParams(supervision="mean", mask="mean")
    fitted, found, _ = fuse(
        few, fitted, found, checkpoint, recipe, moves.motion, unfused, schedule, **shared
    )
    assert found.kind == motion
    model = avatar_from_artifact(fitted, few.body, CPU)
    assert model.kind == recipe.model.kind
    assert reblur(model, few, found)["psnr_train"] > 5
