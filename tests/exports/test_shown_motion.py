"""Motions that an export is asked for."""

import pytest

from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.shown_motion import shown_motions


@pytest.fixture
def run(rough, fitted_run):
    return fitted_run(rough())


@pytest.mark.parametrize(
    ("first", "second", "name"),
    [
        ("a/dance.npz", "b/dance.npz", "dance"),
        ("own", "own.npz", "own"),
        ("builtin:jumping_jacks", "jumping_jacks.bvh", "jumping_jacks"),
    ],
)
def test_two_motions_of_one_name_are_refused_before_either_is_read(run, first, second, name):
    with pytest.raises(ConfigError, match=f"{first} and {second} would both be called '{name}'"):
        shown_motions(run, [first, second], 30.0, 1.0)


def test_a_word_that_is_typed_twice_is_refused(run):
    with pytest.raises(ConfigError, match="each once"):
        shown_motions(run, ["own", "own"], 30.0, 1.0)


def test_motions_of_two_names_come_in_their_order(run):
    motions = shown_motions(run, ["builtin:jumping_jacks", "own"], 30.0, 1.0)
    assert [motion.name for motion in motions] == ["jumping_jacks", "own"]
