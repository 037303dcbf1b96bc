"""SPZ and SOG hold what the PLY holds, to the precision that each stores."""

import gzip
import io
import json
import sys
import zipfile

import numpy as np
import pytest
from PIL import Image

from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.exports.upright import upright_of
from tests.exports.requirement import imported


def exported(run, name, path):
    parse(ExportParams, {"format": name, "frame": 2}, "export").export(run, path)
    return upright_of(run).for_splats().gaussians(posed_frame(run, 2))


def read_spz(content: bytes) -> dict[str, np.ndarray]:
    """Version 3, after Niantic's description: planes of fixed-point numbers behind 16 bytes."""
    data = gzip.decompress(content)
    magic, version, count = np.frombuffer(data[:12], "<u4")
    assert (int(magic).to_bytes(4, "little"), version) == (b"NGSP", 3)
    degree, fraction = data[12], data[13]
    assert degree == 0
    sizes = {"means": 9, "opacities": 1, "colors": 3, "scales": 3, "quats": 4}
    planes, start = {}, 16
    for name, size in sizes.items():
        planes[name] = np.frombuffer(data[start : start + size * count], np.uint8)
        start += size * int(count)
    steps = planes["means"].reshape(-1, 3, 3).astype(np.int32)
    steps = steps[..., 0] | steps[..., 1] << 8 | steps[..., 2] << 16
    steps -= (steps >> 23) << 24  # 24 bits, signed
    harmonics = (planes["colors"].reshape(-1, 3) / 255 - 0.5) / 0.15
    return {
        "means": steps / 2.0**fraction,
        "opacities": planes["opacities"] / 255,
        "colors": 0.5 + 0.28209479 * harmonics,
        "scales": np.exp(planes["scales"].reshape(-1, 3) / 16 - 10),
    }


def nearest(read: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Which read point each wanted one is; writers may change the order."""
    return np.linalg.norm(read[None] - wanted[:, None], axis=2).argmin(1)


def test_an_spz_is_the_pose_to_its_precision(rough, fitted_run, tmp_path):
    imported("gaussforge")
    wanted = exported(fitted_run(rough()), "spz", tmp_path / "a.spz")
    read = read_spz((tmp_path / "a.spz").read_bytes())
    order = nearest(read["means"], wanted.means.numpy())
    assert len(set(order.tolist())) == len(order) == 600
    np.testing.assert_allclose(read["means"][order], wanted.means, atol=1.3e-4)
    np.testing.assert_allclose(read["opacities"][order], wanted.opacities, atol=2.1e-3)
    np.testing.assert_allclose(read["colors"][order], wanted.colors, atol=4e-3)
    ratio = np.sort(read["scales"][order], 1) / np.sort(wanted.scales.numpy(), 1)
    assert np.abs(np.log(ratio)).max() < 0.033  # half a sixteenth


def test_a_sog_is_the_pose_to_its_precision(rough, fitted_run, tmp_path):
    imported("gaussforge")
    wanted = exported(fitted_run(rough()), "sog", tmp_path / "a.sog")
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        about = json.loads(archive.read("meta.json"))
        low, high = (
            np.asarray(Image.open(io.BytesIO(archive.read(name))).convert("RGB"), np.int64)
            for name in about["means"]["files"]
        )
    levels = ((high << 8) | low).reshape(-1, 3)[:600] / 65535
    mins, maxs = np.array(about["means"]["mins"]), np.array(about["means"]["maxs"])
    logs = mins + levels * (maxs - mins)
    means = np.sign(logs) * np.expm1(np.abs(logs))
    order = nearest(means, wanted.means.numpy())
    assert len(set(order.tolist())) == 600
    np.testing.assert_allclose(means[order], wanted.means, atol=1e-4)


@pytest.mark.parametrize("name", ["spz", "sog"])
def test_without_gaussforge_the_error_says_what_to_install(
    rough, fitted_run, tmp_path, monkeypatch, name
):
    monkeypatch.setitem(sys.modules, "gaussforge", None)
    with pytest.raises(ConfigError, match=r"pip install 'deblur-avatar\[spz\]'"):
        exported(fitted_run(rough()), name, tmp_path / f"a.{name}")
