"""USD time samples, read by a reader that others wrote from the format's description."""

import sys

import numpy as np
import pytest
import torch

from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.rendering.covariances import covariances
from tests.exports.requirement import imported

EXPORTER = parse(
    ExportParams, {"format": "usd", "motion": "own", "fps": 30.0, "seconds": 1.0}, "export"
)


def test_another_programs_reader_finds_every_frame(rough, fitted_run, tmp_path):
    imported("pxr")
    lightusd = imported("lightusd")
    run = fitted_run(rough())
    EXPORTER.export(run, tmp_path / "a.usdc")
    splats = lightusd.load(str(tmp_path / "a.usdc")).prim_at("/Avatar/Splats")
    for frame in (0, 4):
        wanted = upright_of(run).gaussians(posed_frame(run, frame))
        read = {
            name: np.asarray(splats.attribute(name).get(float(frame)))
            for name in ("positions", "orientations", "scales")
        }
        np.testing.assert_allclose(read["positions"], wanted.means, atol=1e-5)
        quats = torch.from_numpy(read["orientations"].astype(np.float32).copy())
        found = covariances(quats, torch.from_numpy(read["scales"].copy()))
        alike = covariances(wanted.quats, wanted.scales)
        torch.testing.assert_close(found, alike, atol=1e-6, rtol=1e-3)
    np.testing.assert_allclose(splats.attribute("opacities").get(), wanted.opacities, atol=1e-6)


def test_without_usd_core_the_error_says_what_to_install(rough, fitted_run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(ConfigError, match=r"pip install 'deblur-avatar\[usd\]'"):
        EXPORTER.export(fitted_run(rough()), tmp_path / "a.usdc")
