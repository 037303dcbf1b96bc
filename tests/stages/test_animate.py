import av
import pytest

from deblur_avatar.imaging.picture_files import read_picture
from deblur_avatar.motion.frame import FixedMotion
from tests.conftest import colourful
from tests.stages.running import run_script

PARAMS = """\
seed: 0
animations:
  capsules-agnostic: {scene: capsules, motion: MOTION, start: 0.0, seconds: 0.5, fps: 8.0,
    image_size: 32, turns: 1.0, travel: 0.0, margin: 0.1, backdrop: 0.5}
"""


@pytest.fixture
def run_stage(tmp_path, body, observations):
    observations.save(tmp_path / "observations")
    colourful(body, len(observations.frames)).to_artifact(1).save(tmp_path / "avatar")
    still = FixedMotion(observations.poses)
    motion = still.to_artifact(observations.poses.betas, observations.timestamps)
    motion.save(tmp_path / "motion")

    def run(motion):
        (tmp_path / "params.yaml").write_text(PARAMS.replace("MOTION", motion))
        options = {
            "name": "capsules-agnostic", "observations": tmp_path / "observations",
            "avatar": tmp_path / "avatar", "fitted": tmp_path / "motion",
            "out": tmp_path / "out", "params_file": tmp_path / "params.yaml",
        }  # fmt: skip
        return run_script("animate", **options)

    return run


def test_it_writes_a_video_that_plays_and_a_contact_sheet(run_stage, tmp_path):
    done = run_stage("builtin:jumping_jacks")
    assert done.returncode == 0, done.stderr
    with av.open(str(tmp_path / "out/video.mp4")) as video:
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
        assert video.streams.video[0].average_rate == 8
    assert len(frames) == 5
    assert frames[0].shape == (32, 32, 3)
    assert frames[0].max() > 60
    sheet = read_picture(tmp_path / "out/contact_sheet.png")
    assert sheet.shape[1] > 5 * 32


def test_a_missing_motion_ends_with_one_line_and_nothing_written(run_stage, tmp_path):
    done = run_stage("dance.bvh")
    assert done.returncode == 1
    assert "ConfigError: no motion file dance.bvh" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
