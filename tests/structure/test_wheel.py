"""The wheel holds all that `deblur-avatar video` needs far from a checkout."""

import zipfile
from pathlib import Path

import pytest

from tests.exports.requirement import imported

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> zipfile.ZipFile:
    builder = imported("hatchling.builders.wheel").WheelBuilder(str(ROOT))
    (path,) = builder.build(directory=str(tmp_path_factory.mktemp("wheel")), versions=["standard"])
    return zipfile.ZipFile(path)


def test_the_pipeline_s_files_are_in_it_as_they_are(wheel):
    for path in (ROOT / "dvc.yaml", ROOT / "params.yaml", *(ROOT / "stages").glob("*.py")):
        name = f"deblur_avatar/pipeline_files/{path.relative_to(ROOT).as_posix()}"
        assert wheel.read(name) == path.read_bytes()


def test_every_file_of_the_package_is_in_it(wheel):
    names = set(wheel.namelist())
    files = [path for path in (ROOT / "deblur_avatar").rglob("*") if path.is_file()]
    ours = {p.relative_to(ROOT).as_posix() for p in files if "__pycache__" not in p.parts}
    assert ours <= names


def test_it_asks_for_one_opencv_and_for_no_package_that_brings_another_torch(wheel):
    (metadata,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    lines = wheel.read(metadata).decode().splitlines()
    asked = [line.split(" ")[1].lower() for line in lines if line.startswith("Requires-Dist: ")]
    names = [name.partition(">")[0].partition("=")[0] for name in asked]
    assert sum(name.startswith("opencv") for name in names) == 1
    assert not {"torchvision", "lpips", "mediapipe", "anny"} & set(names)
