"""What `params.yaml` says of growth in `lean`: it waits for the motion."""

import pytest

from deblur_avatar.config.reading import load_params
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams
from tests.structure.pipeline_files import ROOT

PARAMS = ROOT / "params.yaml"
SCHEDULES = load_params(PARAMS, "schedules", dict[str, ScheduleParams])


@pytest.mark.parametrize("name", SCHEDULES)
def test_lean_adds_no_gaussian_before_motion_is_fitted(name):
    densify = load_params(PARAMS, "avatars.lean", RecipeParams).fitting.densify
    assert densify.start * SCHEDULES[name].scale >= SCHEDULES[name].warmup
