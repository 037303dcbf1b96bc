"""What networks get wrong inside an exposure is measured, and nought where they do not."""

from dataclasses import replace

import pytest
import torch

from benchmarks.stress.exposures import EVERY, blend_measures, shared_condition_db, true_blur
from benchmarks.stress.fit import FitSetup, fit_method
from benchmarks.stress.input import prepare
from benchmarks.stress.params import StabilitySceneParams
from benchmarks.stress.scene import film_scene
from deblur_avatar.config.reading import load_params
from deblur_avatar.training.schedule import ScheduleParams
from tests.structure.pipeline_files import ROOT

PARAMS = ROOT / "stability/params.yaml"
CPU = torch.device("cpu")
SCHEDULE = ScheduleParams(
    warmup=2, trajectory=4, fusion=6, gaussians=60, image_height=32, levels=()
)
SMALL = {"frames": 12, "image_size": 32, "test_cameras": 1, "test_stride": 4, "window": 17,
         "samples_per_axis": 1}  # fmt: skip

POSITION = 48  # numbers that the non-rigid network knows of a place; of the pose are the others


def filmed(**changes):
    scene = load_params(PARAMS, "scenes.turn_33", StabilitySceneParams)
    scene = scene.model_copy(update={"clip": scene.clip.model_copy(update=SMALL | changes)})
    body, clip, reference = film_scene(scene, torch.Generator().manual_seed(0))
    return prepare(clip, body, {"exact_poses": 0.0}, 32, 10, 0).blurred, reference


@pytest.fixture(scope="module")
def scene():
    return filmed()


def set_up(method):
    """Skinning weights are hardly learned beforehand: nothing here depends on them."""
    setup = replace(FitSetup.of(method, PARAMS, 0, CPU), schedule=SCHEDULE)
    model = setup.networks.model
    skinning = model.skinning.model_copy(update={"pretrain": 3})
    quick = model.model_copy(update={"skinning": skinning})
    return replace(setup, networks=setup.networks.model_copy(update={"model": quick}))


def fit(seen, schedule=SCHEDULE):
    setup = replace(set_up("paper"), schedule=schedule)
    return fit_method(seen, setup, setup.networks)


@pytest.fixture(scope="module")
def fitted(scene):
    return fit(scene[0])


class Blend(torch.nn.Module):
    """Instead of a fusion network: M as it is told to be."""

    sees_pose = False

    def __init__(self, answer):
        super().__init__()
        self.answer = answer

    def forward(self, sharp, covered, code, frame):
        return self.answer(frame).expand(covered.shape)[..., None]


def test_blur_is_as_wide_as_the_body_moves(scene):
    seen, reference = scene
    shorter = filmed(window=9)[0]
    widths = true_blur(seen, reference, 4)
    assert float(widths.max()) > 1
    ratio = true_blur(shorter, reference, 4).mean() / widths.mean()
    assert float(ratio) == pytest.approx(9 / 17, rel=0.25)


def test_nothing_blurs_who_stands_still():
    seen, reference = filmed(motion="still")
    assert float(true_blur(seen, reference, 4).max()) < 0.3


def test_a_blend_that_follows_the_blur_is_told_from_one_that_does_not(scene, fitted):
    seen, reference = scene
    follows = Blend(lambda frame: 0.5 + 0.01 * true_blur(seen, reference, frame))
    told = blend_measures(seen, reference, replace(fitted, blend=follows), CPU)
    assert told["blend_correlation"] == pytest.approx(1.0, abs=1e-4)
    assert 0.5 < told["blend_mean"] < 1
    against = Blend(lambda frame: 0.5 - 0.01 * true_blur(seen, reference, frame))
    told = blend_measures(seen, reference, replace(fitted, blend=against), CPU)
    assert told["blend_correlation"] == pytest.approx(-1.0, abs=1e-4)


def test_a_blend_that_collapsed_follows_nothing(scene, fitted):
    collapsed = replace(fitted, blend=Blend(lambda frame: torch.zeros(1, 1)))
    assert blend_measures(*scene, collapsed, CPU) == {"blend_mean": 0.0, "blend_correlation": None}


def test_without_a_network_there_is_no_blend(scene, fitted):
    nothing = {"blend_mean": None, "blend_correlation": None}
    assert blend_measures(*scene, replace(fitted, blend=None), CPU) == nothing


def test_the_network_is_kept_as_fusion_left_it(scene):
    again = [fit(scene[0], schedule=SCHEDULE.model_copy(update={"fusion": n})) for n in (101, 102)]
    weights = [one.blend.look.weight for one in again]
    assert not torch.equal(*weights)
    assert fit(scene[0]).blend is None  # too short for a state to be saved
    told = blend_measures(*scene, again[0], CPU)
    assert 0 < told["blend_mean"] < 1


def test_networks_that_follow_the_pose_are_not_the_same_all_exposure(scene, fitted):
    seen, _ = scene
    known = shared_condition_db(seen, fitted, CPU)
    assert known is not None
    weights = {name: value.clone() for name, value in fitted.avatar.networks.items()}
    weights["nonrigid.layers.0.weight"][:, POSITION:] *= 300  # what it makes of the pose
    louder = replace(fitted, avatar=replace(fitted.avatar, networks=weights))
    assert abs(shared_condition_db(seen, louder, CPU)) > 10 * abs(known) + 1e-3


def test_one_instant_is_conditioned_for_itself(scene):
    setup = set_up("agnostic")
    assert shared_condition_db(scene[0], fit_method(scene[0], setup, setup.networks), CPU) is None


def test_without_networks_nothing_is_shared(scene):
    setup = set_up("paper")
    assert shared_condition_db(scene[0], fit_method(scene[0], setup, setup.plain), CPU) is None
    assert len(scene[0].train[::EVERY]) > 1
