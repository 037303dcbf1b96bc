"""Avatars and motions are chosen apart: each of the one is fitted with each of the other."""

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

CPU = torch.device("cpu")


def quiet(iteration, terms):
    pass


@pytest.mark.parametrize("motion", KINDS)
@pytest.mark.parametrize("avatar", AVATARS)
def test_any_avatar_is_fitted_with_any_motion(avatar, motion, observations, schedule, tiny_content):
    surface = tiny_content["avatars"]["arah_small"]
    surface["model"]["samples"] |= {"near": 5, "front": 3, "free": 6}
    surface["model"]["sdf"]["hidden"] = [32, 32, 32]
    surface["model"]["skinning"]["hidden"] = [16, 16]
    surface["fitting"]["rays"]["patches"] = 60
    recipes = [
        recipe for recipe in tiny_content["avatars"].values() if recipe["model"]["kind"] == avatar
    ]
    motions = [method["trajectory"]["motion"] for method in tiny_content["methods"].values()]
    content = {
        "motion": next(section for section in motions if section["kind"] == motion),
        "supervision": "mean",
        "mask": "mean",
    }
    recipe = parse(RecipeParams, recipes[0], "recipe")
    moves = parse(TrajectoryParams, content, "trajectory")
    schedule = schedule.model_copy(update={"warmup": 1, "trajectory": 2, "fusion": 4})
    torch.manual_seed(0)
    shared = {"device": CPU, "generator": torch.Generator().manual_seed(0), "report": quiet}
    fitted, checkpoint, _ = warm_up(observations, recipe, schedule, **shared)
    fitted, found, checkpoint, _ = fit_trajectory(
        observations, fitted, checkpoint, recipe, moves, schedule, **shared
    )
    unfused = UnfusedParams(supervision="mean", mask="mean")
    fitted, found, _ = fuse(
        observations, fitted, found, checkpoint, recipe, moves.motion, unfused, schedule, **shared
    )
    assert found.kind == motion
    model = avatar_from_artifact(fitted, observations.body, CPU)
    assert model.kind == avatar
    assert reblur(model, observations, found)["psnr_train"] > 5
