import dataclasses
import math

import pytest
import torch

from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.motion.clip import ClipMotion
from deblur_avatar.motion.frame import FrameMotion
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.pipeline.trajectory import TrajectoryParams, fit_trajectory, new_trajectory
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training import resume, trainer
from deblur_avatar.training.resume import run_folder

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")


def quiet(iteration, terms):
    pass


@pytest.fixture
def method(tiny_content):
    def make(name="paper", **changes):
        section = tiny_content["methods"][name]["trajectory"]
        return parse(
            TrajectoryParams, section | {"motion": section["motion"] | changes}, "trajectory"
        )

    return make


@pytest.fixture
def warm(observations, recipe, schedule):
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    avatar, checkpoint, _ = warm_up(
        observations, recipe, schedule, device=CPU, generator=generator, report=quiet
    )
    return avatar, checkpoint


@pytest.fixture
def go_on(observations, recipe, schedule, warm):
    def run(params, report=quiet, folder=None):
        torch.manual_seed(1)
        return fit_trajectory(
            observations, *warm, recipe, params, schedule, device=CPU,
            generator=torch.Generator().manual_seed(1), report=report, folder=folder,
        )  # fmt: skip

    return run


def test_the_paper_has_five_instants_from_start_to_end(go_on, method, schedule, observations):
    iterations = []
    avatar, motion, checkpoint, cost = go_on(
        method(), report=lambda iteration, _: iterations.append(iteration)
    )
    assert iterations == list(range(schedule.warmup + 1, schedule.trajectory + 1))
    assert motion.kind == "pair"
    torch.testing.assert_close(motion.u, torch.linspace(0, 1, 5))
    assert motion.body_pose.shape == (len(observations.frames), 5, 23, 3)
    assert torch.equal(motion.timestamps, observations.timestamps)
    assert avatar.iteration == checkpoint.iteration == schedule.trajectory
    assert cost["gaussians"] == len(avatar.means)
    assert cost["seconds"] > 0


def test_without_a_model_of_blur_the_body_stands_still_in_a_refined_pose(
    go_on, method, observations
):
    _, motion, _, _ = go_on(method("agnostic"))
    assert motion.kind == "frame"
    assert motion.u.tolist() == [0.5]
    torch.testing.assert_close(motion.body_pose[:, 0], motion.centre.body_pose)
    trained = list(observations.train)
    apart = (motion.centre.body_pose - observations.poses.body_pose).abs().flatten(1).amax(1)
    assert (apart[trained] > 1e-5).all()


def test_fixed_poses_stay_as_they_were_given(go_on, method, observations):
    _, motion, _, _ = go_on(method("ceiling"))
    found, given = (axis_angle_to_matrix(p.axis_angle) for p in (motion.centre, observations.poses))
    torch.testing.assert_close(found, given)


def test_the_optimisers_go_on_where_the_warm_up_stopped(go_on, method, warm, schedule):
    _, _, checkpoint, _ = go_on(method())
    name = "networks.network.color.network.last.weight.step"
    assert warm[1].tensors[name] == schedule.warmup
    assert checkpoint.tensors[name] == schedule.trajectory
    steps = schedule.trajectory - schedule.warmup
    assert checkpoint.tensors["networks.motion.start.step"] == steps


def test_what_was_handed_over_is_not_changed(go_on, method, warm):
    avatar, checkpoint = warm
    before = {"means": avatar.means.clone()}
    before |= {name: value.clone() for name, value in checkpoint.tensors.items()}
    go_on(method())
    assert torch.equal(avatar.means, before.pop("means"))
    assert all(torch.equal(checkpoint.tensors[name], value) for name, value in before.items())


def test_equal_seeds_fit_equal_motions(go_on, method):
    (_, one, _, _), (_, same, _, _) = go_on(method()), go_on(method())
    assert torch.equal(one.parameters["start"], same.parameters["start"])


def test_new_trajectories_start_from_the_given_poses(observations, method):
    generator = torch.Generator().manual_seed(0)
    pair = new_trajectory(observations, method(virtual_poses=3).motion, generator)
    assert isinstance(pair, PairMotion)
    assert pair.u.tolist() == [0.0, 0.5, 1.0]
    frame = new_trajectory(observations, method("agnostic").motion, generator)
    assert isinstance(frame, FrameMotion)
    for trajectory in (pair, frame):
        expected = axis_angle_to_matrix(observations.poses.axis_angle[1])
        torch.testing.assert_close(trajectory(1).centre_rotations, expected, atol=1e-3, rtol=0)


@pytest.mark.parametrize("name", ["agnostic", "paper", "lean", "mad", "learned"])
def test_a_motion_that_was_stopped_ends_with_the_same_bytes(
    go_on, method, name, schedule, monkeypatch, tmp_path
):
    monkeypatch.setattr(resume, "SAVE_EVERY_S", 0.0)
    monkeypatch.setattr(trainer, "NEIGHBOUR_REFRESH", 2)

    def stop(iteration, terms):
        if iteration == schedule.trajectory - 1:
            raise KeyboardInterrupt

    avatar, motion, memory, _ = go_on(method(name))
    with pytest.raises(KeyboardInterrupt), run_folder(tmp_path / "item", "key", frozenset()) as run:
        go_on(method(name), stop, run)
    with run_folder(tmp_path / "item", "key", frozenset()) as run:
        assert run.progress is not None
        assert schedule.warmup < run.progress.iteration < schedule.trajectory
        again, same, remembered, _ = go_on(method(name), folder=run)
    assert torch.equal(again.means, avatar.means)
    for key, value in motion.parameters.items():
        assert torch.equal(same.parameters[key], value), key
    for key, value in memory.tensors.items():
        assert torch.equal(remembered.tensors[key], value), key


def test_an_estimated_shutter_comes_with_its_uncertainty(go_on, method, observations):
    _, motion, _, cost = go_on(
        method(
            "lean", shutter={"kind": "estimated", "rate": 0.02, "weight": 1e-3}, pixels_per_pose=0.0
        )
    )
    assert motion.shutter == cost["shutter_s"]
    assert 0 < cost["shutter_std_s"] < cost["shutter_s"]
    assert cost["shutter_from"] in ("frames", "guess")
    assert float(motion.parameters["halfway"]) != 0
    _, motion, _, cost = go_on(method("lean"))
    assert motion.shutter is None
    assert not any(name.startswith("shutter") for name in cost)


def test_a_shutter_is_an_unknown_where_the_clip_only_guesses_it(observations, method):
    told = method("lean", shutter={"kind": "as_told", "rate": 0.02, "weight": 0.0}).motion
    guessed = dataclasses.replace(observations, exposure_std=0.7)
    given = method("lean", shutter={"kind": "given"}).motion
    for seen, params, unknown in (
        (observations, told, False), (guessed, told, True), (guessed, given, False),
    ):  # fmt: skip
        trajectory = new_trajectory(seen, params, torch.Generator())
        assert trajectory.log_shutter.requires_grad is unknown


@pytest.mark.parametrize(
    ("share", "std", "longest"),
    [(0.5, 0.7, 1.0), (1.0, 0.7, 1.0), (1 + 1e-7, 0.7, 1.0), (2.0, 0.7, 8.0), (0.5, None, 2.0)],
)
def test_a_guessed_shutter_is_closed_when_the_next_frame_begins(
    observations, method, share, std, longest
):
    frame = float(observations.timestamps.diff().median())
    seen = dataclasses.replace(observations, exposure=share * frame, exposure_std=std)
    shutter = {"kind": "estimated", "rate": 0.02, "weight": 0.0}
    trajectory = new_trajectory(seen, method("lean", shutter=shutter).motion, torch.Generator())
    for log_shutter in (50.0, -0.2):
        with torch.no_grad():
            trajectory.log_shutter.fill_(log_shutter)
        trajectory.keep_possible()
        found = trajectory.estimated_shutter(observations.timestamps) / frame
        wanted = longest if log_shutter > 0 else share * math.exp(log_shutter)
        assert found == pytest.approx(wanted, rel=1e-4)


def test_unknowns_are_kept_possible_after_every_step(go_on, method, schedule, monkeypatch):
    calls = []
    monkeypatch.setattr(ClipMotion, "keep_possible", lambda self: calls.append(self))
    go_on(method("lean"))
    assert len(calls) == schedule.trajectory - schedule.warmup


def test_one_blurred_frame_has_no_trajectory(make_observations, method):
    single = make_observations(frames=2)
    index = slice(0, 1)
    single = dataclasses.replace(
        single, frames=single.frames[index], mattes=single.mattes[index],
        poses=single.poses.at(index), weights=single.weights[index], frame_indices=(0,),
        timestamps=single.timestamps[index], train=(0,), validation=(),
    )  # fmt: skip
    with pytest.raises(ConfigError, match="two frames or more, the clip has 1"):
        new_trajectory(single, method("lean").motion, torch.Generator())
