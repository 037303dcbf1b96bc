"""What every kind of trajectory keeps to, and that a new one needs no other module."""

import dataclasses
from typing import Literal

import pytest
import torch
from torch import nn

from deblur_avatar.artifacts.motion import NAMES_ON_DISK, Motion
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.evaluation.reblur import poses_of_exposure, reblur
from deblur_avatar.geometry.rotations import axis_angle_to_quat
from deblur_avatar.methods import MethodParams
from deblur_avatar.motion.kinds import KINDS, kind_of, trajectory_from_artifact
from deblur_avatar.motion.trajectory import Instants, MotionParams, Trajectory
from deblur_avatar.pipeline.fusion import fuse
from deblur_avatar.pipeline.trajectory import TrajectoryParams, fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up

CPU = torch.device("cpu")
UNFITTED = 4


def quiet(iteration, terms):
    pass


@pytest.fixture
def section(tiny_content):
    """The section of any kind: that of the first method that has it, or of one with one key."""
    methods = tiny_content["methods"].values()
    stated = {m["trajectory"]["motion"]["kind"]: m["trajectory"]["motion"] for m in methods}

    def make(kind, **changes):
        return parse(KINDS[kind].Params, stated[kind] | changes, kind)

    return make


@pytest.fixture
def create(section, make_observations):
    def make(kind, **changes):
        seen = dataclasses.replace(
            make_observations(frames=8), train=(0, 1, 2, 3, 5, 6, 7), validation=(UNFITTED,)
        )
        generator = torch.Generator().manual_seed(0)
        return KINDS[kind].create(seen, section(kind, **changes), generator), seen

    return make


@pytest.mark.parametrize("kind", KINDS)
def test_what_no_trained_frame_has_taught_does_not_show_in_a_frame_set_aside(create, body, kind):
    trajectory, seen = create(kind)

    def rendered():
        motion = trajectory.to_artifact(seen.poses.betas, seen.timestamps)
        poses = poses_of_exposure(body, motion, UNFITTED, seen.train)
        return torch.cat([poses.axis_angle.flatten(), poses.transl.flatten()])

    unknowns = [value for value in trajectory.parameters() if value.requires_grad]
    generator = torch.Generator().manual_seed(0)
    for frame in seen.train if unknowns else ():
        seen_instants = vars(trajectory(frame)).values()
        pull = [(torch.rand(v.shape, generator=generator) * v).sum() for v in seen_instants]
        torch.stack(pull).sum().backward()
    before = rendered()
    with torch.no_grad():
        for value in unknowns:
            slope = torch.zeros_like(value) if value.grad is None else value.grad
            untaught = slope == 0
            # Whole rows: where one of their numbers is pulled on, others may be zero by chance.
            if value.ndim > 1:
                untaught = untaught.flatten(1).all(1)
            value[untaught] += 0.3
    assert torch.equal(rendered(), before)


@pytest.mark.parametrize("kind", KINDS)
def test_every_unknown_is_in_one_group_that_has_a_rate_under_its_own_name(create, section, kind):
    trajectory, _ = create(kind)
    groups = trajectory.parameter_groups()
    unknown = {
        group for group, named in groups.items() if any(value.requires_grad for _, value in named)
    }
    assert unknown <= section(kind).learning_rates().keys()
    named = [entry for group in groups.values() for entry in group]
    assert len(named) == len({name for name, _ in named})
    parameters = dict(trajectory.named_parameters())
    assert {name for name, value in parameters.items() if value.requires_grad} <= dict(named).keys()
    assert all(parameters[name] is value for name, value in named)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_says_what_it_is_called_and_takes_no_other_keys(create, section, kind):
    trajectory, seen = create(kind)
    motion = trajectory.to_artifact(seen.poses.betas, seen.timestamps)
    assert motion.kind == trajectory.kind == kind
    assert kind_of(motion) is type(trajectory_from_artifact(motion)) is KINDS[kind]
    content = {"motion": section(kind).model_dump(), "supervision": "mean", "mask": "mean"}
    assert parse(TrajectoryParams, content, "trajectory").motion == section(kind)
    content["motion"]["knots"] = 3
    with pytest.raises(ConfigError, match="unknown key 'motion.knots'"):
        parse(TrajectoryParams, content, "trajectory")


def test_an_unknown_kind_is_refused_by_naming_those_there_are(tiny_content):
    content = tiny_content["methods"]["paper"]
    content["trajectory"]["motion"] = {"kind": "spiral"}
    message = "trajectory.motion: no kind of this name, there is fixed, frame, pair, cubic, lea"
    with pytest.raises(ConfigError, match=message):
        parse(MethodParams, content, "methods.paper")


def test_tensors_have_the_names_on_disk_that_they_always_had(create):
    clip, seen = create("clip", shutter={"kind": "estimated", "rate": 0.02, "weight": 1e-3})
    saved = clip.to_artifact(seen.poses.betas, seen.timestamps)
    assert list(saved.parameters) == [
        "axis_angle", "transl", "log_shutter",
        "middles", "guess", "taken", "first_axis_angle", "first_transl", "halfway",
    ]  # fmt: skip
    assert set(NAMES_ON_DISK.values()) < saved.parameters.keys()


class DriftParams(MotionParams):
    """The least that a kind has: its name, and a rate for its unknown."""

    kind: Literal["drift"]
    rate: float

    def learning_rates(self):
        return {"velocity": self.rate}


class DriftMotion(Trajectory):
    """Every joint as given, and a velocity for the whole clip."""

    kind = "drift"
    Params = DriftParams
    knows_unfitted = True

    def __init__(self, poses):
        super().__init__()
        self.register_buffer("u", torch.tensor([0.25, 0.75]), persistent=False)
        self.register_buffer("given", poses.axis_angle)
        self.register_buffer("place", poses.transl.clone())
        self.velocity = nn.Parameter(torch.zeros(3))

    @classmethod
    def create(cls, observations, params, generator):
        return cls(observations.poses)

    @classmethod
    def from_artifact(cls, motion: Motion):
        trajectory = cls(motion.centre)
        trajectory.load_state_dict(motion.parameters)
        return trajectory

    def at(self, frame, u):
        quats = axis_angle_to_quat(self.given[frame])
        transl = self.place[frame] + (u[:, None] - 0.5) * self.velocity
        return Instants(quats.expand(len(u), -1, -1), transl, quats, self.place[frame])

    def parameter_groups(self):
        return {"velocity": [("velocity", self.velocity)]}


def test_a_new_kind_needs_its_module_and_a_line(monkeypatch, observations, recipe, schedule):
    monkeypatch.setitem(KINDS, DriftMotion.kind, DriftMotion)
    content = {
        "trajectory": {
            "motion": {"kind": "drift", "rate": 1e-4},
            "supervision": "mean",
            "mask": "mean",
        },
        "fusion": {"supervision": "mean", "mask": "mean"},
    }
    method = parse(MethodParams, content, "methods.drift")
    torch.manual_seed(0)
    shared = {
        "device": CPU, "generator": torch.Generator().manual_seed(0), "report": quiet,
    }  # fmt: skip
    warm = warm_up(observations, recipe, schedule, **shared)
    avatar, motion, checkpoint, _ = fit_trajectory(
        observations, *warm[:2], recipe, method.trajectory, schedule, **shared
    )
    assert checkpoint.tensors["networks.motion.velocity.step"] > 0
    avatar, motion, _ = fuse(
        observations,
        avatar,
        motion,
        checkpoint,
        recipe,
        method.trajectory.motion,
        method.fusion,
        schedule,
        **shared,
    )
    assert motion.kind == "drift"
    assert motion.parameters["velocity"].abs().max() > 0
    model = avatar_from_artifact(avatar, observations.body, CPU)
    assert reblur(model, observations, motion)["psnr"] > 10
