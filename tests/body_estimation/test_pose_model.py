import pytest

from deblur_avatar.body_estimation import pose_model
from deblur_avatar.body_estimation.pose_model import heavy_file, install_heavy, installed_model
from deblur_avatar.errors import ArtifactError
from tests.missing_pose_model import WEIGHTS, without_heavy_model


@pytest.fixture
def place(monkeypatch, tmp_path):
    return without_heavy_model(monkeypatch, tmp_path)


def test_the_place_is_where_mediapipe_looks():
    pytest.importorskip("mediapipe", reason="mediapipe is not installed")
    file = heavy_file()
    assert file is not None
    assert (file.parent / "pose_landmark_full.tflite").is_file()


def test_without_mediapipe_there_is_no_place(monkeypatch):
    monkeypatch.setattr(pose_model.importlib.util, "find_spec", lambda name: None)
    assert heavy_file() is None
    assert installed_model() == "full"


def test_the_largest_model_that_is_there_is_taken(place):
    assert installed_model() == "full"
    assert install_heavy(WEIGHTS, "a file") == place
    assert installed_model() == "heavy"
    assert place.read_bytes() == WEIGHTS
    assert list(place.parent.iterdir()) == [place]  # nothing half written stays


def test_other_weights_are_refused_and_nothing_is_written(place):
    with pytest.raises(ArtifactError, match=r"^mine\.tflite: not the weights .*22 bytes came"):
        install_heavy(WEIGHTS[:-1], "mine.tflite")
    assert not place.exists()


def test_without_mediapipe_weights_have_nowhere_to_go(place, monkeypatch):
    monkeypatch.setattr(pose_model, "heavy_file", lambda: None)
    with pytest.raises(ArtifactError, match="mediapipe is not installed"):
        install_heavy(WEIGHTS, "a file")
