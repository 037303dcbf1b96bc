import pytest

from deblur_avatar.cli import view
from deblur_avatar.cli.main import main
from deblur_avatar.exports.live_viewer import LiveViewer
from tests.exports.requirement import imported


@pytest.fixture
def niceness(monkeypatch, fitting):
    """By how much the process has stepped back, each time."""
    imported("viser")
    found = []
    monkeypatch.setattr(view.os, "nice", found.append)
    monkeypatch.setattr(LiveViewer, "run", LiveViewer.stop)
    monkeypatch.chdir(fitting)
    return found


def test_a_fit_on_this_machine_goes_first(niceness, begin, end):
    end("fusion", "anna-agnostic")
    begin("trajectory", snapshots=(9,))
    assert main(["view", "anna-agnostic", "--port", "0"]) == 0  # which offers the other one, too
    assert niceness == [10]


def test_a_viewer_of_what_is_fitted_does_not_step_back(niceness, end):
    end("fusion")
    assert main(["view", "anna-lean", "--port", "0"]) == 0
    assert niceness == []
