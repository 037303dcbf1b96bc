"""Whatever a parameter may be is run by a small case."""

from pathlib import Path

import pytest

from deblur_avatar.errors import ConfigError
from deblur_avatar.motion.kinds import KINDS
from deblur_avatar.sources.registry import SOURCES
from tests.equivalence.cases import footage_variables, jobs_of
from tests.equivalence.coverage import uncovered

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def jobs():
    return jobs_of(ROOT)


def test_every_kind_has_a_case(jobs):
    assert uncovered(jobs) == set()


@pytest.mark.parametrize(("key", "registry"), [("source", SOURCES), ("kind", KINDS)])
def test_a_kind_without_a_case_is_found(jobs, key, registry, monkeypatch):
    monkeypatch.setitem(registry, "invented", next(iter(registry.values())))
    assert uncovered(jobs) == {(key, "invented")}


@pytest.mark.parametrize(
    "word",
    [
        ("mask", "union"),
        ("supervision", "fused"),
        ("averaging_space", "linear"),
        ("exposure_gain", "frame"),
    ],
)
def test_a_word_of_a_parameter_without_a_case_is_found(jobs, word):
    assert uncovered([job for job in jobs if list(word) not in job.words]) >= {word}


def test_stages_that_are_compared_have_a_case(jobs):
    assert {job.stage for job in jobs} >= {
        "body", "clip", "blur", "score_blur", "preprocess", "predeblur", "score_predeblur", "check",
        "warmup", "trajectory", "fusion", "evaluate", "learning_curve", "animate", "self_check",
        "export",
        "stability", "stability_scene",
    }  # fmt: skip


def test_videos_that_are_not_there_are_told_before_any_case_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("POSE2SIM_ROOT", str(tmp_path / "nowhere"))
    with pytest.raises(ConfigError, match=r"nowhere: small cases .* name it in POSE2SIM_ROOT"):
        footage_variables(tmp_path / "footage", ROOT)
    monkeypatch.setenv("POSE2SIM_ROOT", str(tmp_path))
    assert footage_variables(tmp_path / "footage", ROOT)["POSE2SIM_ROOT"] == str(tmp_path)
