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
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.shown_motion import ShownMotion, poses_at
from deblur_avatar.exports.upright import Upright, rest_pelvis, upright_of
from deblur_avatar.geometry.cameras import Camera, camera_centres
from deblur_avatar.geometry.rotations import quat_to_matrix

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"  # nobody else's business
MOVING, RESTING = 320, 768  # pixels of the longer side
REST = 0.4  # seconds without a change, after which pictures are large
PAUSE = 0.02  # seconds between two looks at what has changed
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


class LiveViewer:
    """A server with a page of its own; `step` draws what has changed."""

    def __init__(self, run: FittedRun, motions: Sequence[ShownMotion], port: int) -> None:
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
        self._server = viser.ViserServer(host=HOST, port=port, label=run.name, verbose=False)
        self._look(run)
        gui = self._server.gui
        self._motion = gui.add_dropdown("Motion", tuple(self._motions))
        self._play = gui.add_checkbox("Play", False)
        self._time: Any = gui.add_slider("Time", 0.0, 1.0, 0.001, 0.0)  # of the whole motion
        self._shutter = gui.add_slider("Shutter (ms)", 0.0, 1000 * LONGEST_SHUTTER, 1.0, 0.0)
        self._last = time.monotonic()

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
                self.step()
                time.sleep(PAUSE)
        except KeyboardInterrupt:
            self.stop()

    def step(self) -> int:
        """Send every browser the picture that it does not have yet; returns how many were sent."""
        self._advance()
        return sum(self._send(client) for client in self._server.get_clients().values())

    def picture(self, view: View, shown: Shown, longest: int) -> UInt8[np.ndarray, "H W 3"]:
        """What a browser is sent."""
        camera = view.camera(self._axes, longest)
        poses = poses_at(shown.motion, shown.times())
        image, _ = render_avatar(self._model, poses, camera, average=len(poses.transl) > 1)
        return (image[0] * 255).round().to(torch.uint8).numpy()

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
