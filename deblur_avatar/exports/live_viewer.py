"""Live viewer: any avatar, networks included, drawn by our rasterizer, turned in a browser.

Conventions. The browser's world is `upright.py`'s. Pictures are drawn here and sent as the
background of an empty scene, because no browser knows networks, linear light or our filter. While
the camera or the motion moves they are small; once all rests they are large.

The only module that knows viser (extra `view`).
"""

import logging
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.shown_motion import ShownMotion
from deblur_avatar.exports.upright import Upright, rest_pelvis, upright_of
from deblur_avatar.geometry.cameras import Camera, camera_centres
from deblur_avatar.geometry.rotations import quat_to_matrix

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"  # nobody else's business
MOVING, RESTING = 320, 768  # pixels of the longer side
REST = 0.4  # seconds without a change, after which pictures are large
NEWS = 2.0  # seconds between two looks at what a fit has left on disk
PAUSE = 0.02  # seconds between two looks at what has changed
# While a fit goes on: times the last step's processor time, so that pictures take a fifth of one.
PAUSE_WHILE_FITTING = 4.0
LONGEST_PAUSE = 0.2  # seconds, after an avatar was loaded, say
INSTANTS = 9  # of an exposure
LONGEST_SHUTTER = 0.1  # seconds
JPEG_QUALITY = 88  # of streamed pictures: edges stay clean


@dataclass(frozen=True)
class View:
    """A browser's camera, in its own world."""

    wxyz: tuple[float, ...]  # camera to world, OpenCV axes
    position: tuple[float, ...]
    fov: float  # vertical, radians
    aspect: float  # width by height

    def camera(self, axes: Upright, longest: int) -> Camera:
        """The same camera in the world of the clip, its picture so many pixels long."""
        width = longest if self.aspect >= 1 else max(round(longest * self.aspect), 16)
        height = max(round(width / self.aspect), 16)
        focal = height / 2 / math.tan(self.fov / 2)
        K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        camera_from_upright = quat_to_matrix(torch.tensor(self.wxyz, dtype=torch.float64)).T
        eye = torch.tensor(self.position, dtype=torch.float64)
        turned = camera_from_upright @ axes.rotation.double()
        viewmat = torch.eye(4)
        viewmat[:3, :3] = turned.float()
        shift = -(turned @ axes.origin.double()) - camera_from_upright @ eye
        viewmat[:3, 3] = shift.float()
        return Camera(K, viewmat, width, height)


@dataclass(frozen=True)
class Shown:
    """What the controls say."""

    motion: ShownMotion
    seconds: float
    shutter: float  # seconds

    def times(self) -> Float[Tensor, " S"]:
        """Midpoints of the exposure's parts; one instant, if the shutter is no time open."""
        count = INSTANTS if self.shutter > 0 else 1
        u = (torch.arange(count).double() + 0.5) / count - 0.5
        return self.seconds + u * self.shutter


@runtime_checkable
class Shelf(Protocol):
    """Runs of one scene that a viewer can show, some of them perhaps still fitted."""

    @property
    def names(self) -> Sequence[str]:
        """Of the runs; the first is shown first."""
        ...

    def news(self, name: str) -> FittedRun | None:
        """A run's avatar, if it is not what was asked for last."""
        ...

    def motions(self, run: FittedRun) -> Sequence[ShownMotion]:
        """What it can be shown in."""
        ...

    def status(self, name: str) -> str:
        """How far fitting is, in a sentence."""
        ...

    def fitting(self, name: str) -> bool:
        """Whether more steps of a run are to come."""
        ...

    def curve(self, name: str) -> list[tuple[int, float]]:
        """Steps of fitting, and how well the avatar of then explains blurred frames, dB."""
        ...


class LiveViewer:
    """A server with a page of its own; `step` draws what has changed.

    Args:
        run: what is shown first.
        motions: what it can be shown in.
        port: on this machine; 0 for any that is free.
        shelf: what can be chosen instead, and what is new of it.
    """

    def __init__(
        self, run: FittedRun, motions: Sequence[ShownMotion], port: int, shelf: Shelf | None = None
    ) -> None:
        try:
            import viser
        except ImportError:
            raise ConfigError("view needs viser; pip install 'deblur-avatar[view]'") from None
        self._axes = upright_of(run)
        body = run.observations.body
        self._model = avatar_from_artifact(run.avatar, body, torch.device("cpu"))
        self._motions = {motion.label: motion for motion in motions}
        self._drawn: dict[int, Any] = {}  # what each browser saw last
        self._changed: dict[int, float] = {}  # and when that was new
        label = run.name if shelf is None else "deblur_avatar"  # which run is said below
        self._server = viser.ViserServer(host=HOST, port=port, label=label, verbose=False)
        self._look(run)
        gui = self._server.gui
        self._motion = gui.add_dropdown("Motion", tuple(self._motions))
        self._play = gui.add_checkbox("Play", False)
        self._time: Any = gui.add_slider("Time", 0.0, 1.0, 0.001, 0.0)  # of the whole motion
        self._shutter = gui.add_slider("Shutter (ms)", 0.0, 1000 * LONGEST_SHUTTER, 1.0, 0.0)
        self._last = time.monotonic()
        self._shelf, self._looked = shelf, -math.inf
        self._curve: Any = None
        self._fitting = False  # the run that is shown
        if shelf is not None:
            self._name = gui.add_dropdown("Run", tuple(shelf.names))
            self._shown_name = self._name.value
            self._status = gui.add_markdown(shelf.status(self._shown_name))

    @property
    def address(self) -> str:
        """Where a browser finds it."""
        return f"http://{HOST}:{self._server.get_port()}"

    def stop(self) -> None:
        """End the server."""
        self._server.stop()

    def run(self) -> None:
        """Draw until the keyboard interrupts."""
        try:
            while True:
                begin = time.process_time()
                self.step()
                time.sleep(self.pause_after(time.process_time() - begin))
        except KeyboardInterrupt:
            self.stop()

    def step(self) -> int:
        """Send every browser the picture that it does not have yet; returns how many were sent."""
        if self._shelf is not None:
            self._look_for_news(self._shelf)
        self._advance()
        return sum(self._send(client) for client in self._server.get_clients().values())

    def pause_after(self, took: float) -> float:
        """Seconds to wait after a step that took so many of a processor: a fit goes first."""
        if not self._fitting:
            return PAUSE
        return min(max(PAUSE_WHILE_FITTING * took, PAUSE), LONGEST_PAUSE)

    def picture(self, view: View, shown: Shown, longest: int) -> UInt8[np.ndarray, "H W 3"]:
        """What a browser is sent."""
        camera = view.camera(self._axes, longest)
        poses = shown.motion.poses.at_times(shown.motion.times.double(), shown.times().double())
        image, _ = render_avatar(self._model, poses, camera, average=len(poses.transl) > 1)
        return (image[0] * 255).round().to(torch.uint8).numpy()

    def _look_for_news(self, shelf: Shelf) -> None:
        """Now and then, and at once if somebody chooses, show what is the newest."""
        name, now = self._name.value, time.monotonic()
        if name == self._shown_name and now - self._looked < NEWS:
            return
        self._shown_name = name
        try:
            run = shelf.news(name)
            if run is not None:
                self._show(run, shelf.motions(run))
            self._fitting = shelf.fitting(name)
            self._status.content = shelf.status(name)
            self._draw_curve(shelf.curve(name))
        except ArtifactError as error:  # a snapshot that was thrown away in between
            logger.warning("%s", error)
        self._looked = time.monotonic()

    def _show(self, run: FittedRun, motions: Sequence[ShownMotion]) -> None:
        """Put another avatar in the place of the one shown; the camera stays."""
        device = torch.device("cpu")
        self._model = avatar_from_artifact(run.avatar, run.observations.body, device)
        self._motions = {motion.label: motion for motion in motions}
        self._drawn.clear()

    def _draw_curve(self, points: list[tuple[int, float]]) -> None:
        if len(points) < 2:  # a line needs two
            return
        import viser

        data = tuple(np.array(column, float) for column in zip(*points, strict=True))
        if self._curve is None:
            line = viser.uplot.Series(label="dB", stroke="#2b6cb0", width=2)
            self._curve = self._server.gui.add_uplot(
                data, (viser.uplot.Series(label="step"), line), title="Blurred frames explained",
                scales={"x": viser.uplot.Scale(time=False)}, aspect=1.6,
            )  # fmt: skip
        else:
            self._curve.data = data

    def _look(self, run: FittedRun) -> None:
        """Begin where the filming camera stood."""
        camera = run.observations.camera
        eye = self._axes.points(camera_centres(camera.viewmat))
        pelvis = self._axes.points(rest_pelvis(run) + run.motion.centre.transl.mean(0))
        begin = self._server.initial_camera
        begin.position, begin.up = tuple(eye.tolist()), (0.0, 1.0, 0.0)
        begin.look_at = (0.0, float(pelvis[1]), 0.0)
        begin.fov = 2 * math.atan(camera.height / 2 / float(camera.K[1, 1]))
        self._server.scene.set_up_direction("+y")

    def _advance(self) -> None:
        now = time.monotonic()
        passed, self._last = now - self._last, now
        duration = float(self._motions[self._motion.value].times[-1])
        if self._play.value and duration > 0:
            self._time.value = (self._time.value + passed / duration) % 1.0

    def _send(self, client: Any) -> bool:
        try:
            camera = client.camera
            view = View(
                tuple(camera.wxyz.tolist()), tuple(camera.position.tolist()), camera.fov,
                camera.aspect,
            )  # fmt: skip
        except AssertionError:  # a browser that has only just come has no camera yet
            return False
        motion = self._motions[self._motion.value]
        seconds = self._time.value * float(motion.times[-1])
        shown = Shown(motion, seconds, self._shutter.value / 1000)
        wanted = (view, motion.name, shown.seconds, shown.shutter)
        number, now = client.client_id, time.monotonic()
        last = self._drawn.get(number)
        if last is None or last[0] != wanted:
            self._changed[number] = now
        longest = RESTING if now - self._changed[number] > REST else MOVING
        if last is not None and last[0] == wanted and longest <= last[1]:
            return False
        picture = self.picture(view, shown, longest)
        client.scene.set_background_image(picture, format="jpeg", jpeg_quality=JPEG_QUALITY)
        self._drawn[number] = (wanted, longest)
        return True
