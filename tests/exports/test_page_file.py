"""The page as a file: small, the same each time, for avatars that a skeleton poses."""

import base64
import dataclasses
import gzip
import json
import re
from itertools import pairwise

import numpy as np
import pytest
import torch

from deblur_avatar.avatars.networks_avatar import NetworksAvatar
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.page.content import _frames
from deblur_avatar.exports.page.export import _without_comments
from deblur_avatar.exports.page.packing import influences, packed_text, quantised, signed
from tests.exports import browser
from tests.exports.page_header import header_of

MOST_BYTES = 500_000  # for 8,000 Gaussians and two motions


def test_a_page_of_8000_gaussians_and_two_motions_is_small(
    rough, fitted_run, page_exporter, make_observations
):
    exporter = page_exporter.model_copy(update={"seconds": 4.0, "pictures": 5})
    filmed = make_observations(size=192)
    run = dataclasses.replace(fitted_run(rough(count=8000)), observations=filmed, sharp=filmed)
    page = exporter.page([run])
    assert {"frame4", "truth4"} < header_of(page)["arrays"].keys()
    assert header_of(page)["avatars"][0]["count"] == 8000
    assert len(header_of(page)["avatars"][0]["motions"]) == 2
    assert len(page) < MOST_BYTES


@pytest.mark.parametrize(("count", "small"), [(10_000, True), (10_001, False)])
def test_frames_take_the_room_that_is_left_up_to_10000_gaussians(
    rough, fitted_run, page_exporter, make_observations, count, small
):
    exporter = page_exporter.model_copy(update={"seconds": 4.0, "pictures": 5})
    filmed = make_observations(size=192)
    noise = torch.randint(
        0, 256, filmed.frames.shape, generator=torch.Generator().manual_seed(0), dtype=torch.uint8
    )
    filmed = dataclasses.replace(filmed, frames=noise)
    run = dataclasses.replace(fitted_run(rough(count=count)), observations=filmed, sharp=filmed)
    page = exporter.page([run])
    header = header_of(page)
    taken = len(header["frames"])
    assert (len(page) < MOST_BYTES) == small
    assert taken == 1 if small else taken == 5
    assert len([name for name in header["arrays"] if name.startswith("truth")]) == taken


def test_an_estimated_shutter_is_the_one_that_frames_are_matched_with(
    rough, fitted_run, page_exporter
):
    run = fitted_run(rough())
    estimated = dataclasses.replace(run, motion=dataclasses.replace(run.motion, shutter=0.004))
    told = header_of(page_exporter.page([run]))["scene"]["exposure"]
    assert told == pytest.approx(run.observations.exposure)
    assert header_of(page_exporter.page([estimated]))["scene"]["exposure"] == pytest.approx(0.004)


def test_frames_lose_quality_before_any_is_left_out(fitted_run, rough, sharp):
    tries = list(_frames(fitted_run(rough(), sharp=sharp), 4))
    assert [len(taken) for taken, _ in tries] == [4] * 5 + [3] * 5 + [2] * 5 + [1] * 5 + [0]
    bytes_of = [sum(file.stored.size for file in files.values()) for _, files in tries]
    assert all(one >= next_ for one, next_ in pairwise(bytes_of[:5]))
    assert bytes_of[0] > bytes_of[4]
    assert tries[-1] == ([], {})


def test_scripts_lose_their_comments_and_nothing_that_runs():
    script = "// What it is.\nconst a = 1; // one\n\n  // and\n  const b = `\n    // in\n  x`;\n"
    assert _without_comments(script) == "const a = 1; // one\nconst b = `\nx`;"


def test_the_same_run_gives_the_same_bytes_and_another_gives_others(
    rough, fitted_run, page_exporter, sharp, tmp_path
):
    for name, space in (("a", "srgb"), ("b", "srgb"), ("c", "linear")):
        run = fitted_run(rough(space), sharp=sharp)
        page_exporter.export(run, tmp_path / f"{name}.html")
    first, again, other = ((tmp_path / f"{name}.html").read_bytes() for name in "abc")
    assert first == again
    assert first != other


def test_a_page_names_nothing_to_load_and_tells_the_bodys_licence(page_file, body):
    page = page_file.read_text()
    assert not re.search(r"https?://|//cdn|@import|<script src|<link rel=.stylesheet", page)
    assert body.licence in page


def test_files_drive_the_avatar_too(rough, fitted_run, page_exporter, tmp_path):
    run = fitted_run(rough())
    rate, turns = np.float64(30), np.zeros((4, 72))
    np.savez(tmp_path / "wave.npz", poses=turns, trans=np.zeros((4, 3)), mocap_framerate=rate)
    exporter = page_exporter.model_copy(update={"motions": ("own", str(tmp_path / "wave.npz"))})
    (avatar,) = header_of(exporter.page([run]))["avatars"]
    assert avatar["motions"][1] == {"name": "wave", "label": "Wave"}


@pytest.mark.parametrize(
    ("motions", "message"),
    [
        ((), "motions must be named, each once"),
        (("own", "own"), "motions must be named, each once"),
        (("builtin:flying",), "no built-in motion 'flying'"),
        (("dance.bvh",), "no motion file dance.bvh"),
    ],
)
def test_motions_that_are_not_there_are_refused(rough, fitted_run, page_exporter, motions, message):
    exporter = page_exporter.model_copy(update={"motions": motions})
    with pytest.raises(ConfigError, match=message):
        exporter.page([fitted_run(rough())])


def test_avatars_with_networks_are_refused_with_what_to_do(
    recipe, body, rough, fitted_run, page_exporter
):
    betas = torch.zeros(body.shape_dirs.shape[2])
    generator = torch.Generator().manual_seed(0)
    networks = NetworksAvatar.create(recipe.model, body, betas, 5, 80, "srgb", generator)
    run = fitted_run(rough(), "capsules-paper")
    run = dataclasses.replace(run, avatar=networks.to_artifact(1))
    with pytest.raises(ConfigError, match="capsules-paper .* kind networks.* plain avatar .lean"):
        page_exporter.page([run])


def test_weights_of_a_gaussian_sum_to_one_exactly_and_keep_the_largest():
    generator = np.random.default_rng(0)
    weights = generator.dirichlet(np.full(24, 0.1), 200)
    stored, joints = influences(weights, most=6, bits=14)
    assert stored.stored.shape == joints.stored.shape == (200, 6)
    assert (stored.stored.sum(1) == 2**14).all()
    assert (joints.stored[:, 0] == weights.argmax(1)).all()
    few = np.zeros((3, 24))
    few[:, 5], few[:, 7] = 0.25, 0.75
    stored, joints = influences(few, most=6, bits=14)
    assert stored.stored.tolist() == [[12288, 4096]] * 3
    assert joints.stored.tolist() == [[7, 5]] * 3


def test_numbers_are_stored_to_half_a_step():
    values = np.random.default_rng(1).normal(size=(50, 3))
    for packed in (quantised(values, 12), signed(values / 10, 14)):
        wanted = values if packed.stored.dtype == np.uint16 else values / 10
        read = np.array(packed.low) + np.array(packed.step) * packed.stored
        assert (np.abs(read - wanted) <= np.array(packed.step) / 2 + 1e-9).all()
    assert signed(np.zeros((1, 2)), 14).stored.tolist() == [[0, 0]]


def test_arrays_lie_where_the_header_says_byte_plane_by_byte_plane():
    values = np.arange(6, dtype=np.float64).reshape(3, 2) * 300
    content = gzip.decompress(base64.b64decode(packed_text({}, {"x": quantised(values, 16)})))
    start = 4 + int.from_bytes(content[:4], "little")
    place = json.loads(content[4:start])["arrays"]["x"]
    assert (place["type"], place["rows"], place["columns"]) == ("u2", 3, 2)
    planes = np.frombuffer(content[start + place["offset"] :], np.uint8).reshape(2, 2, 3)
    read = (planes[:, 0] + 256 * planes[:, 1].astype(int)).T * place["step"] + place["low"]
    np.testing.assert_allclose(read, values, atol=0.02)


def test_without_a_browser_tests_skip_but_not_in_continuous_integration(monkeypatch):
    monkeypatch.setattr(browser.shutil, "which", lambda name: None)
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match="apt-get install chromium"), browser.chromium():
        pass
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match=r"\.ci/run"), browser.chromium():
        pass
