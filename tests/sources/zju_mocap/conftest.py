import shutil

import pytest

from deblur_avatar.bodies.smpl import read_smpl
from deblur_avatar.config.reading import parse
from deblur_avatar.pipeline.clip import ClipParams
from tests.zju_sequence import SHAPES, write_sequence

PARAMS = {
    "source": "zju_mocap", "root": "", "frames": [0, None], "stride": 1, "fps": 60.0,
    "image_height": 128, "train_camera": 0, "test_cameras": "all", "test_stride": 3,
    "pose_cameras": [], "mask_folders": ["mask", "mask_cihp"], "mask_dilation": 0,
    "background": "black", "poses": "new_params", "held_out": 0.0,
}  # fmt: skip


@pytest.fixture(scope="session")
def sequence(tmp_path_factory):
    """Six frames of nine cameras; not to be changed."""
    return write_sequence(tmp_path_factory.mktemp("zju"), 6)


@pytest.fixture(scope="session")
def smpl(sequence):
    return read_smpl(sequence.smpl_file, SHAPES)


@pytest.fixture
def root(sequence, tmp_path):
    """The same sequence, one's own to damage."""
    return shutil.copytree(sequence.root, tmp_path / "CoreView_9")


@pytest.fixture
def params(sequence):
    def make(**changes):
        return parse(ClipParams, {**PARAMS, "root": str(sequence.root), **changes}, "clip")

    return make
