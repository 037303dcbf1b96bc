import pytest

from tests.exports.page_header import header_of
from tests.stages.running import run_script

PARAMS = """\
exports:
  capsules-lean:
    scene: capsules
    files:
      avatar.html: {format: page, motions: [MOTION], fps: 8.0, seconds: 0.5, pictures: 2}
      motion.npz: {format: npz}
"""


@pytest.fixture
def run_stage(tmp_path, scene):
    scene.observations.save(tmp_path / "observations")
    scene.avatar.save(tmp_path / "fusion/avatar")
    scene.motion.save(tmp_path / "fusion/motion")
    (tmp_path / "sharp").mkdir()  # as preprocess leaves it where no sharp frames are known

    def run(motion):
        (tmp_path / "params.yaml").write_text(PARAMS.replace("MOTION", motion))
        options = {
            "name": "capsules-lean", "observations": tmp_path / "observations",
            "sharp": tmp_path / "sharp", "fusion": tmp_path / "fusion", "out": tmp_path / "out",
            "params_file": tmp_path / "params.yaml",
        }  # fmt: skip
        return run_script("export", **options)

    return run


def test_it_writes_the_files_of_its_section(run_stage, tmp_path):
    done = run_stage("builtin:jumping_jacks")
    assert done.returncode == 0, done.stderr
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        "avatar.html", "motion.npz",
    ]  # fmt: skip


def test_sharp_frames_that_are_known_go_on_the_page(run_stage, tmp_path, scene):
    for known in (False, True):
        if known:
            scene.observations.save(tmp_path / "sharp")
        assert run_stage("own").returncode == 0
        header = header_of((tmp_path / "out/avatar.html").read_bytes())
        assert ("truth1" in header["arrays"]) == known


def test_a_missing_motion_ends_with_one_line(run_stage):
    done = run_stage("dance.bvh")
    assert done.returncode == 1
    assert "ConfigError: no motion file dance.bvh" in done.stderr
    assert "Traceback" not in done.stderr
