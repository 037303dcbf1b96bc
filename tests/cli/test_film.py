import pytest
import torch
from ruamel.yaml import YAML

from deblur_avatar.cli.main import main
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.sources.monocular import load_monocular
from deblur_avatar.sources.studio.street import load_street
from deblur_avatar.sources.video_files import read_video
from tests.sources.studio.test_street import OPTIONS, PLAIN, everyone_is_in_the_middle
from tests.sources.test_monocular import params as of_video


@pytest.fixture
def folder(tiny_content, body, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = tiny_content["scenes"]["studio"]
    film = {**PLAIN, "size": list(PLAIN["size"]), "encoding": OPTIONS["encoding"]}
    clip = {
        "source": "street", "film": film, "given": "nothing", "test_cameras": 1,
        "test_stride": 2, "test_size": 16,
    }  # fmt: skip
    tiny_content["scenes"]["mine"] = scene | {"clip": clip}
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    body.save(tmp_path / "data" / "body" / scene["body"])
    (tmp_path / "dvc.yaml").touch()  # as in a checkout
    (tmp_path / "stages").mkdir()
    return tmp_path


def test_a_street_scene_becomes_a_video_file_with_the_frames_of_its_clip(folder, body):
    assert main(["film", "mine", "--out", "mine.mp4"]) == 0
    video = read_video(folder / "mine.mp4", 0, None, 1000)
    assert video.frames.shape == (3, 48, 64, 3)
    street = load_params(folder / "params.yaml", "scenes.mine.clip", ClipParams)
    clip, _ = load_street(street, body, everyone_is_in_the_middle)
    own, _ = load_monocular(of_video(folder / "mine.mp4", image_height=48), body, torch.zeros_like)
    assert torch.equal(own.frames, clip.frames)


def test_scenes_that_write_no_video_are_refused(folder, capsys):
    assert main(["film", "studio", "--out", "studio.mp4"]) == 1
    assert "scenes.studio writes no video" in capsys.readouterr().err
