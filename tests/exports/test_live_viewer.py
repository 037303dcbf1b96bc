"""The live viewer shows a real browser what the rasterizer draws, networks included."""

import dataclasses
import io
import math
import sys
import time

import numpy as np
import pytest
import torch
from PIL import Image

from deblur_avatar.avatars.networks_avatar import NetworksAvatar
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.exports.live_viewer import LiveViewer, Shown, View
from deblur_avatar.exports.shown_motion import shown_motions
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.geometry.rotations import matrix_to_quat
from tests.exports.requirement import imported

MOTIONS = ("own", "builtin:jumping_jacks")


@pytest.fixture
def networks_run(recipe, body, rough, fitted_run):
    betas = torch.zeros(body.shape_dirs.shape[2])
    generator = torch.Generator().manual_seed(0)
    model = NetworksAvatar.create(recipe.model, body, betas, 5, 80, "srgb", generator)
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(3.0)
        model.gaussians.log_scales.add_(0.5)
    return dataclasses.replace(fitted_run(rough(), "capsules-paper"), avatar=model.to_artifact(1))


@pytest.fixture
def viewer(networks_run):
    imported("viser")
    started = LiveViewer(networks_run, shown_motions(networks_run, MOTIONS, 30.0, 1.0), 0)
    yield started
    started.stop()


def filming(run) -> View:
    """The filming camera as a browser would have it."""
    camera, axes = run.observations.camera, upright_of(run)
    upright_from_camera = axes.rotation @ camera.viewmat[:3, :3].T
    eye = axes.points(-camera.viewmat[:3, :3].T @ camera.viewmat[:3, 3])
    fov = 2 * math.atan(camera.height / 2 / float(camera.K[1, 1]))
    quat = matrix_to_quat(upright_from_camera)
    return View(tuple(quat.tolist()), tuple(eye.tolist()), fov, camera.width / camera.height)


def test_a_picture_is_the_rasterizers(viewer, networks_run):
    motions = shown_motions(networks_run, MOTIONS, 30.0, 1.0)
    shown = Shown(motions[0], float(motions[0].times[3]), 0.0)
    camera = networks_run.observations.camera
    ours, _ = render_avatar(viewer._model, motions[0].poses.at([3]), camera)
    theirs = viewer.picture(filming(networks_run), shown, camera.width)
    np.testing.assert_allclose(theirs / 255, ours[0].numpy(), atol=0.01)


def test_the_shutter_is_the_mean_of_sharp_instants(rough, fitted_run):
    imported("viser")
    run = fitted_run(rough())
    (motion,) = shown_motions(run, ("own",), 30.0, 1.0)
    viewer = LiveViewer(run, [motion], 0)
    shown = Shown(motion, float(motion.times[2]), 1 / 30)
    blurred = viewer.picture(filming(run), shown, 24) / 255
    sharp = [
        viewer.picture(filming(run), Shown(motion, float(seconds), 0.0), 24) / 255
        for seconds in shown.times()
    ]
    viewer.stop()
    u = (np.arange(len(sharp)) + 0.5) / len(sharp) - 0.5  # midpoints
    np.testing.assert_allclose(shown.times(), shown.seconds + shown.shutter * u)
    np.testing.assert_allclose(blurred, np.mean(sharp, 0), atol=0.01)
    assert np.abs(blurred - sharp[0]).max() > 0.1


def test_a_browser_is_sent_what_changes_and_no_more(viewer, browser):
    assert viewer.address.startswith("http://127.0.0.1:")
    context = browser.new_context(viewport={"width": 640, "height": 480})
    page = context.new_page()
    page.goto(viewer.address)

    def sent(seconds: float) -> int:
        count, end = 0, time.monotonic() + seconds
        while time.monotonic() < end:
            count += viewer.step()
            page.wait_for_timeout(20)
        return count

    deadline = time.monotonic() + 60
    while not sent(0.5) and time.monotonic() < deadline:
        pass
    sent(3.0)
    assert sent(0.5) == 0  # all rests

    def seen() -> np.ndarray:
        picture = Image.open(io.BytesIO(page.screenshot()))
        return np.asarray(picture.convert("RGB").crop((0, 100, 320, 480)), int)

    before = seen()
    page.mouse.move(160, 300)
    page.mouse.down()
    page.mouse.move(260, 280, steps=4)
    page.mouse.up()
    assert sent(2.0) >= 1
    page.wait_for_timeout(500)
    assert np.abs(seen() - before).max() > 40
    context.close()


class Offered:
    """Two avatars to choose from."""

    names = ("dim", "bright")

    def __init__(self, runs):
        self.runs, self.last = runs, None

    def news(self, name):
        before, self.last = self.last, name
        return None if name == before else self.runs[name]

    def motions(self, run):
        return shown_motions(run, ("own",), 30.0, 1.0)

    def status(self, name):
        return f"of {name}"

    def fitting(self, name):
        return name == "bright"

    def curve(self, name):
        if name == "dim":
            raise ArtifactError("no snapshot/1")  # thrown away in between
        return [(1, 20.0), (4, 25.0)]


def test_another_run_is_shown_once_it_is_chosen(rough, fitted_run, caplog):
    imported("viser")
    runs = {}
    for name, level in (("dim", -4.0), ("bright", 4.0)):
        model = rough()
        with torch.no_grad():
            model.gaussians.features.fill_(level)
        runs[name] = fitted_run(model, name)
    shelf = Offered(runs)
    viewer = LiveViewer(runs["dim"], shelf.motions(runs["dim"]), 0, shelf)
    shown = Shown(shelf.motions(runs["dim"])[0], 0.0, 0.0)
    viewer.step()
    assert viewer.pause_after(0.1) == viewer.pause_after(0.0) < 0.05
    assert "no snapshot/1" in caplog.text
    assert viewer.picture(filming(runs["dim"]), shown, 24).max() < 40
    viewer._name.value = "bright"
    viewer.step()
    viewer.step()
    assert viewer.picture(filming(runs["dim"]), shown, 24).max() > 200
    assert viewer.pause_after(0.03) == pytest.approx(0.12)  # a fit has four fifths of the time
    assert 0.12 < viewer.pause_after(9.0) < 0.5
    assert viewer._status.content == "of bright"
    assert [list(column) for column in viewer._curve.data] == [[1, 4], [20, 25]]
    viewer.stop()


def test_without_viser_the_error_says_what_to_install(networks_run, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    motions = shown_motions(networks_run, ("own",), 30.0, 1.0)
    with pytest.raises(ConfigError, match=r"pip install 'deblur-avatar\[view\]'"):
        LiveViewer(networks_run, motions, 0)
