import pytest

from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.pipeline.export import ExportsParams, export

PLY, NPZ = {"format": "ply", "frame": 0}, {"format": "npz"}


def params(**files):
    content = {"scene": "capsules", "files": {k.replace("_", "."): v for k, v in files.items()}}
    return parse(ExportsParams, content, "exports.capsules-lean")


@pytest.fixture
def run(scene):
    return FittedRun("capsules-lean", scene.avatar, scene.motion, scene.observations)


def test_every_file_is_written_in_its_format(run, tmp_path):
    export(run, params(a_ply=PLY, b_npz=NPZ), tmp_path / "out", "exports.capsules-lean")
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["a.ply", "b.npz"]


@pytest.mark.parametrize("name", ["a.obj", "../a.ply", "a"])
def test_a_name_that_is_not_of_its_format_is_refused_before_any_file(run, tmp_path, name):
    content = {"scene": "capsules", "files": {"b.npz": NPZ, name: PLY}}
    section = parse(ExportsParams, content, "exports.capsules-lean")
    with pytest.raises(ConfigError, match=r"exports\.capsules-lean\.files: .* ends in '\.ply'"):
        export(run, section, tmp_path / "out", "exports.capsules-lean")
    assert not (tmp_path / "out").exists()


def test_an_unknown_format_is_named():
    with pytest.raises(ConfigError, match=r"files\.a\.obj: no format of this name, there is page"):
        params(a_obj={"format": "obj"})
