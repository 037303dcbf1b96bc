import pytest

from deblur_avatar.cli.shelf import SceneRuns
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.exports.live_viewer import Shelf


def test_runs_of_one_scene_that_have_an_avatar_can_be_chosen(fitting, begin, end):
    for name in ("anna-agnostic", "anna-other"):
        end("fusion", name)
    begin("trajectory", snapshots=(9,))
    shelf = SceneRuns(fitting, "anna-lean", ["own"])
    assert isinstance(shelf, Shelf)
    assert shelf.names == ("anna-lean", "anna-agnostic")  # not that of elsewhere
    assert shelf.news("anna-lean").name == "anna-lean, step 9 of 18"
    assert shelf.news("anna-lean") is None
    assert shelf.news("anna-agnostic").name == "anna-agnostic"
    assert shelf.news("anna-lean").name == "anna-lean, step 9 of 18"
    begin("trajectory", snapshots=(9, 12))
    news = shelf.news("anna-lean")
    assert news.name == "anna-lean, step 12 of 18"
    assert [motion.label for motion in shelf.motions(news)] == ["As filmed"]


def test_it_says_how_far_fitting_is(fitting, begin, end):
    begin("warmup", snapshots=(4,), saved=5, seconds=10.0)
    shelf = SceneRuns(fitting, "anna-lean", ["own"])
    assert shelf.fitting("anna-lean")
    assert shelf.status("anna-lean") == ("Step 5 of 18, about 26 s of fitting left. Shown: step 4.")
    end("warmup")
    assert shelf.status("anna-lean") == "Step 6 of 18."
    end("fusion")
    assert shelf.status("anna-lean") == "Fitted: 18 steps."
    assert not shelf.fitting("anna-lean")


def test_a_fit_of_a_schedule_that_is_gone_is_said_to_be_one(fitting, begin):
    begin("warmup", snapshots=(3,), saved=4)
    shelf = SceneRuns(fitting, "anna-lean", ["own"])
    assert shelf.fitting("anna-lean")
    assert shelf.status("anna-lean") == "Step 4, of another schedule. Shown: step 3."


def test_every_avatar_on_the_way_becomes_a_point_of_the_curve_one_a_call(fitting, begin, end):
    begin("warmup", snapshots=(4, 6))
    shelf = SceneRuns(fitting, "anna-lean", ["own"])
    assert [step for step, _ in shelf.curve("anna-lean")] == [4]
    assert [step for step, _ in shelf.curve("anna-lean")] == [4, 6]
    assert shelf.curve("anna-lean") == shelf.curve("anna-lean")
    (first, second) = (score for _, score in shelf.curve("anna-lean"))
    assert first == second > 15  # the same avatar twice


def test_without_any_avatar_it_says_what_is_missing(fitting):
    with pytest.raises(ArtifactError, match="no avatar/1 in data/fusion/anna-lean, no snapshot"):
        SceneRuns(fitting, "anna-lean", ["own"])
    with pytest.raises(ConfigError, match="bob"):
        SceneRuns(fitting, "bob", ["own"])
