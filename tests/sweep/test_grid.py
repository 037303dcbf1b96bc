"""A grid of parameters becomes experiments that DVC knows."""

import json
import subprocess
from pathlib import Path

import pytest

from deblur_avatar.errors import ConfigError
from deblur_avatar.sweep.grid import grid, name_of, tasks_of
from tests.sweep.small_sweep import MORE, called, copied, swept, swept_here


def test_every_combination_is_there_once():
    assert grid(["a.b=1,2", "c=x"]) == [{"a.b": "1", "c": "x"}, {"a.b": "2", "c": "x"}]
    assert len(grid(["a=1,2,3", "b=1,2"])) == 6
    assert grid([]) == [{}]


@pytest.mark.parametrize("words", [["a"], ["a="], ["=1"], ["a=1,,2"], ["a=1", "a=2"]])
def test_what_is_no_grid_is_refused(words):
    with pytest.raises(ConfigError, match="-S "):
        grid(words)


def test_names_tell_experiments_apart_or_are_refused():
    assert name_of("p/dvc.yaml", {"p/params.yaml:schedule": "short", "m.l.knots": "1e-3"}) == (
        "p-dvc.yaml_p-params.yaml-schedule-short_m.l.knots-1e-3"
    )
    tasks = tasks_of(Path(), "p/dvc.yaml", [*grid(["a.b=1,2"]), {"c.b": "1"}], 10.0)
    assert list(tasks) == [f"p-dvc.yaml_{chosen}" for chosen in ("a.b-1", "a.b-2", "c.b-1")]
    with pytest.raises(ConfigError, match="would be called p-dvc.yaml_a.b-x-y"):
        tasks_of(Path(), "p/dvc.yaml", grid(["a.b=x/y,x-y"]), 10.0)


def test_sweeps_of_two_targets_leave_each_other_s_experiments():
    targets = ("p/dvc.yaml", "p/dvc.yaml:fit@a", "p/dvc.yaml:fit@b", "q/dvc.yaml", "q/dvc.yaml")
    (*names, same) = (
        name for target in targets for name in tasks_of(Path(), target, [{"a": "1"}], 1.0)
    )
    assert len(set(names)) == 4
    assert same == names[-1]  # which takes its place


def test_long_names_stay_apart_and_short_enough_for_a_file():
    key = "methods.lean.trajectory.motion.knot_frames"
    same = {f"{key}{index}": "1" for index in range(9)}
    long = [name_of("p/dvc.yaml", same | {"last": value}) for value in ("1", "2")]
    assert long[0] != long[1]
    assert max(map(len, long)) < 220


@pytest.mark.parametrize(
    ("target", "key", "value"),
    [
        ("../up/dvc.yaml:fit@a", "../up/params.yaml:a", "1."), ("./dvc.yaml", "+a", "x.lock"),
        ("-p/dvc.yaml:fit@..", "a", "..."), ("p/dvc.yaml", "p/params.yaml:a.b", "~^:?*[@{ \\é"),
        ("dvc.yaml", "a" * 400, "1"), ("dvc.yaml", "a" * 189, ".."), (f"{'p' * 199}.", "a", "1"),
    ],
)  # fmt: skip
def test_git_takes_every_name(target, key, value):
    name = name_of(target, {key: value})
    assert not name.startswith("-")  # it is a command's argument
    subprocess.run(["git", "check-ref-format", f"refs/exps/ab/cd/{name}"], check=True)


VALUES = ("-S", f"{MORE}/params.yaml:runs.more_one.size=1,2")


def test_experiments_of_what_is_out_of_date_are_refused(made, tmp_path):
    stale = swept_here(copied(made, tmp_path / "stale"), MORE, *VALUES)
    assert stale.returncode == 1
    assert "5 stages are out of date as they stand" in stale.stderr


def test_experiments_are_what_dvc_shows(serial, tmp_path):
    project = copied(serial, tmp_path / "project")
    (project / "params.yaml").write_text((project / "params.yaml").read_text() + "\n# mine\n")
    changed = swept_here(project, MORE, *VALUES)
    assert changed.returncode == 1
    assert "commit your changes first" in changed.stderr
    called(project, "git", "checkout", "-q", "params.yaml")
    done = swept(project, MORE, *VALUES, "--at-once", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 of 2 tasks done" in done.stdout
    value = "experiments-more-params.yaml-runs.more_one.size"
    of_all = {f"experiments-more-dvc.yaml_{value}-{size}": size for size in (1, 2)}
    assert sizes(project) == of_all
    stage = f"{MORE}/dvc.yaml:fit@more_one"
    assert swept(project, stage, VALUES[0], VALUES[1].removesuffix(",2")).returncode == 0
    assert sizes(project) == of_all | {f"experiments-more-dvc.yaml-fit-more_one_{value}-1": 1}


def sizes(project):
    """What every experiment was made with, by its name."""
    (shown,) = json.loads(called(project, "dvc", "exp", "show", "--json"))[1:]
    made = {one["name"]: one["revs"][0]["data"]["params"] for one in shown["experiments"]}
    told = {name: params[f"{MORE}/params.yaml"]["data"]["runs"] for name, params in made.items()}
    return {name: runs["more_one"]["size"] for name, runs in told.items()}
