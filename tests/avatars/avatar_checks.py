"""What holds for avatars of every kind: fits, learning rates, saving, settings, exports."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.exports.rigged import rigged_avatar
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training import resume, trainer
from deblur_avatar.training.resume import run_folder
from tests.randomness import seeded

CPU = torch.device("cpu")


class Stopped(Exception):
    """A fit that ends early."""


def state_of(avatar, angles, transl=(0.0, 0.0, 0.0), step=None, frame=0):
    """What `condition` gives for a pose, and its transforms."""
    rotations = axis_angle_to_matrix(angles)
    transforms = avatar.transforms(rotations, torch.tensor(transl).to(angles))
    return avatar.condition(rotations, frame, transforms, torch.eye(4), step), transforms


def drawn(avatar, angles, camera, transl=(0.0, 0.0, 0.0), step=None, **options):
    """One pose, rendered."""
    state, transforms = state_of(avatar, angles, transl, step)
    return avatar.render(state, transforms[None], camera, **options)


def rates_of_all_unknowns(avatar, recipe):
    """Learning rates by group; every parameter is in one of them."""
    groups = avatar.parameter_groups()
    rates = recipe.fitting.learning_rates(recipe.final_share)
    assert groups.keys() == rates.keys()
    held = [value for named in groups.values() for _, value in named]
    assert len(held) == len(set(held))
    assert set(held) == set(avatar.parameters())
    return rates


def all_unknowns_are_in_networks(avatar) -> None:
    """Every parameter is saved, none as a Gaussian's."""
    names = {name for named in avatar.parameter_groups().values() for name, _ in named}
    saved = avatar.to_artifact(1)
    assert names == saved.networks.keys()
    assert len(saved.means) == 0


def model_is_refused(params: Any, model: dict[str, Any], path: str, value: object) -> None:
    """A model whose key at a dotted path has a value that it cannot have; the error names it."""
    *above, last = path.split(".")
    section = model[above[0]] if above else model
    section[last] = value
    with pytest.raises(ConfigError, match=last):
        parse(params, model, "model")


def is_drawn_as_saved(avatar, body, poses, camera, folder) -> None:
    """An avatar that went to the disk and back makes the same pictures."""
    saved = avatar.to_artifact(7)
    assert saved.model["params"]["kind"] == avatar.kind
    saved.save(folder)
    again = avatar_from_artifact(type(saved).load(folder), body, CPU)
    for before, after in zip(
        render_avatar(avatar, poses, camera), render_avatar(again, poses, camera), strict=True
    ):
        assert torch.equal(before, after)


def fitted(observations, recipe, schedule, iterations, report=lambda *_: None, folder=None):
    """A warm-up alone."""
    torch.manual_seed(0)
    length = schedule.model_copy(
        update={"warmup": iterations, "trajectory": iterations + 1, "fusion": iterations + 2}
    )
    return warm_up(
        observations, recipe, length, device=CPU, generator=seeded(), report=report, folder=folder
    )


def same_unknowns(one, other) -> None:
    for name in ("means", "quats", "log_scales", "opacity_logits", "features"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    assert one.networks.keys() == other.networks.keys()
    for name, value in one.networks.items():
        assert torch.equal(value, other.networks[name]), name


def fitted_twice(observations, recipe, schedule, iterations):
    """The avatar of a fit and the terms of its steps; a second fit ends with the same bytes."""
    runs = []
    for _ in range(2):
        terms = []
        avatar, _, _ = fitted(
            observations, recipe, schedule, iterations,
            lambda _, found, to=terms: to.append(found),
        )  # fmt: skip
        runs.append(avatar)
    same_unknowns(*runs)
    return runs[0], terms


def stopped_ends_with_the_same_bytes(
    fit: Callable[..., Any], monkeypatch, folder, *, refresh: int, stop_at: int, saved_at: int
):
    """Memories of a fit that ran through and of one that was stopped, whose avatars are the same.

    Args:
        fit: takes `report` and `folder`.
        monkeypatch: pytest's.
        folder: of the stopped fit.
        refresh: iterations from looking up neighbours to the next time.
        stop_at: iteration after which it is stopped.
        saved_at: the one that it goes on from.
    """
    monkeypatch.setattr(resume, "SAVE_EVERY_S", 0.0)
    monkeypatch.setattr(trainer, "NEIGHBOUR_REFRESH", refresh)

    def stop(iteration, terms):
        if iteration == stop_at:
            raise Stopped

    whole, memory, _ = fit()
    with pytest.raises(Stopped), run_folder(folder, "key", frozenset()) as kept:
        fit(report=stop, folder=kept)
    with run_folder(folder, "key", frozenset()) as kept:
        assert kept.progress is not None
        assert kept.progress.iteration == saved_at
        again, remembered, _ = fit(folder=kept)
    same_unknowns(whole, again)
    return memory, remembered


def no_rig_carries_it(avatar, why: str, observations, motion) -> FittedRun:
    """Exports that need a skeleton refuse it, by its kind and why."""
    run = FittedRun(f"capsules-{avatar.kind}", avatar.to_artifact(1), motion, observations)
    with pytest.raises(ConfigError, match=f"kind {avatar.kind}, {why}"):
        rigged_avatar(run)
    return run


def nothing_exports_it(avatar, why: str, observations, motion) -> None:
    """Exports that need Gaussians of one colour each refuse it, too."""
    run = no_rig_carries_it(avatar, why, observations, motion)
    with pytest.raises(
        ConfigError, match=f"kind {avatar.kind} is no set of Gaussians of one colour each"
    ):
        posed_frame(run, 0)
