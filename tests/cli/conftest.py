"""Runs that are fitted or being fitted: what they leave on disk, as fitting writes it."""

import dataclasses
import shutil

import pytest
import torch
from ruamel.yaml import YAML

from deblur_avatar.cli import shared_bodies
from deblur_avatar.training.resume import Snapshot, run_folder

ENDS = {"warmup": 6, "trajectory": 12, "fusion": 18}  # snapshots at 4 and 9, too
LONGER = {"warmup": 20, "trajectory": 40, "fusion": 80}


@pytest.fixture(autouse=True)
def cache(tmp_path_factory, monkeypatch):
    """The user's cache, of a user who has nothing."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setattr(shared_bodies, "cache_folder", lambda: folder)
    return folder


@pytest.fixture
def fitting(tmp_path, scene):
    """A run of which nothing was fitted yet."""
    run = {"scene": "capsules", "observations": "blurred", "avatar": "lean", "method": "lean"}
    sizes = {"gaussians": 80, "image_height": 24, "levels": []}
    content = {
        "from": {"footage": "data"}, "schedule": "tiny", "snapshots": 2,
        "schedules": {"tiny": ENDS | sizes, "longer": LONGER | sizes},
        "runs": {"anna-lean": run, "anna-other": run | {"scene": "elsewhere"},
                 "anna-agnostic": run | {"method": "agnostic"}},
    }  # fmt: skip
    scene.observations.save(tmp_path / "data/preprocess/capsules/blurred")
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(content, file)
    return tmp_path


@pytest.fixture
def begin(fitting, scene):
    """Begin a stage, let it come to some iterations, and stop it there."""

    def begin(stage, snapshots=(), saved=None, seconds=0.0, name="anna-lean"):
        item = "capsules-blurred-lean" if stage == "warmup" else name
        with run_folder(fitting / "data" / stage / item, "key", frozenset(snapshots)) as place:
            for iteration in snapshots:
                avatar = dataclasses.replace(scene.avatar, iteration=iteration)
                place.keep(iteration, 1.0, Snapshot(avatar=avatar, motion=scene.motion))
            if saved is not None:
                place.save(saved, seconds, 0, {"model.means": torch.zeros(3)})

    return begin


@pytest.fixture
def end(fitting, scene):
    """End a stage, as its script does."""

    def end(stage, name="anna-lean"):
        item = "capsules-blurred-lean" if stage == "warmup" else name
        out = fitting / "data" / stage / item
        dataclasses.replace(scene.avatar, iteration=ENDS[stage]).save(out / "avatar")
        if stage != "warmup":
            scene.motion.save(out / "motion")
        shutil.rmtree(out.with_name(f".{out.name}.unfinished"), ignore_errors=True)

    return end


@pytest.fixture
def project(tmp_path, monkeypatch, scene):
    """A checkout with one fitted run, and an avatar of a video's with two."""
    run = {"scene": "capsules", "observations": "blurred", "avatar": "lean", "method": "lean"}
    for folder, runs in (("", ["capsules-lean"]), ("avatars/anna", ["anna-lean", "anna-paper"])):
        place = tmp_path / folder
        for name in runs:
            fitted = dataclasses.replace(scene.avatar, iteration=ENDS["fusion"])
            fitted.save(place / "data/fusion" / name / "avatar")
            scene.motion.save(place / "data/fusion" / name / "motion")
        scene.observations.save(place / "data/preprocess/capsules/blurred")
        sizes = {"gaussians": 80, "image_height": 24, "levels": []}
        content = {
            "from": {"footage": "data"}, "runs": dict.fromkeys([*runs, "unmade"], run),
            "schedule": "tiny", "schedules": {"tiny": ENDS | sizes}, "snapshots": 0,
        }  # fmt: skip
        with (place / "params.yaml").open("w") as file:
            YAML().dump(content, file)
    monkeypatch.chdir(tmp_path)
    return tmp_path
