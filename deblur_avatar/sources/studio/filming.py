"""Filming: a camera's blurred frames of a person in a street, instant by instant.

Conventions. The studio's world. Frame f is at f / fps seconds, the middle of its middle row's
exposure. Everything seen is an instant in linear light; blur, noise and codes come after, in that
order (`sensor.py`). S instants a frame.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import joint_transforms
from deblur_avatar.rendering.mesh_rendering import Lighting, TexturedMesh, View, render
from deblur_avatar.sources.focal_length import focal_of_view
from deblur_avatar.sources.studio.backdrop import Plane, draw_backdrop, street
from deblur_avatar.sources.studio.cameras import AIM, DISTANCE
from deblur_avatar.sources.studio.hand_held import CameraPath, camera_path
from deblur_avatar.sources.studio.held_prop import HeldProp, create_prop, joined
from deblur_avatar.sources.studio.motion import Moves, move
from deblur_avatar.sources.studio.passer_by import PasserBy, create_passer_by
from deblur_avatar.sources.studio.person import Person, create_person
from deblur_avatar.sources.studio.sensor import expose_rows, gains, instants_of_frame, record
from deblur_avatar.sources.studio.source import BETAS, LIGHTING
from deblur_avatar.sources.studio.street_params import FilmParams
from deblur_avatar.sources.studio.unfitted_body import (
    swing_of_joints,
    unfitted_body,
    with_more_hair,
)

EYE_HEIGHT = 1.45  # metres
WHITE = Lighting(ambient=1.0, sky=0.0, lamps=())


@dataclass(frozen=True)
class Set:
    """All that is decided before the first picture is taken."""

    params: FilmParams
    body: Body  # the fitter's; its joints are the person's
    betas: Float[Tensor, " B"]
    person: Person
    camera: CameraPath
    K: Float[Tensor, "3 3"]  # pixels
    backdrop: list[Plane]
    passer_by: PasserBy | None
    prop: HeldProp | None

    @property
    def seconds(self) -> float:
        """Length of the clip."""
        return self.params.frames / self.params.fps

    @property
    def timestamps(self) -> Float[Tensor, " F"]:
        """Seconds, the middle of each frame's exposure."""
        return torch.arange(self.params.frames, dtype=torch.float64) / self.params.fps

    def moves(self, times: Float[Tensor, " M"]) -> Moves:
        """The person's poses at evenly spaced times, the cloth hanging or swinging."""
        moves = move(self.params.motion, times, self.seconds)
        unfitted = self.params.unfitted_body
        if unfitted is None or unfitted.swing == 0:
            return moves
        swing = unfitted.swing * swing_of_joints(self.body, self.betas, moves, times)
        return replace(moves, swing=swing)


@dataclass(frozen=True)
class Take:
    """What the camera recorded, and how much of each pixel was the person."""

    frames: UInt8[Tensor, "F H W 3"]
    mattes: UInt8[Tensor, "F H W"]


def build_set(params: FilmParams, body: Body, generator: torch.Generator) -> Set:
    """Dress everyone, put up the street and draw the camera's way.

    Raises:
        ConfigError: if the motion is not known.
    """
    betas = torch.zeros(body.shape_dirs.shape[2])
    betas[: len(BETAS)] = torch.tensor(BETAS)[: len(betas)]
    seed = int(torch.randint(1 << 31, (1,), generator=generator))
    person = create_person(body, betas)
    if params.unfitted_body is not None:
        person = create_person(unfitted_body(body, params.unfitted_body, generator), betas)
        person = with_more_hair(person, params.unfitted_body.hair_mm)
    width, height = params.size
    focal = focal_of_view(params.field_of_view, params.size)
    return Set(
        params=params,
        body=body,
        betas=betas,
        person=person,
        camera=camera_path(
            (0.0, EYE_HEIGHT, DISTANCE), (0.0, AIM, 0.0), params.frames / params.fps,
            params.hand_held, generator,
        ),
        K=torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]),
        backdrop=[] if params.backdrop is None else street(np.random.default_rng(seed)),
        passer_by=None if params.passer_by is None else create_passer_by(body, params.passer_by),
        prop=None if params.held_prop is None else create_prop(body, betas, params.held_prop),
    )  # fmt: skip


def film(scene: Set, generator: torch.Generator) -> Take:
    """Take all frames; what comes before the file is written."""
    params, frames, mattes = scene.params, [], []
    times = _times_of_instants(scene)
    seen = _instants(scene, times)
    count = times.shape[1]
    for time in run.progress(scene.timestamps.tolist(), "filming the street"):
        stack = torch.from_numpy(np.stack([next(seen) for _ in range(count)]))
        blurred = expose_rows(stack, params.instants)
        gain = gains(time, params.exposure_drift)
        frames.append(record(blurred[..., :3], gain, params.noise, generator))
        mattes.append((blurred[..., 3].clamp(0, 1) * 255).round().to(torch.uint8))
    return Take(torch.stack(frames), torch.stack(mattes))


def _times_of_instants(scene: Set) -> Float[Tensor, "F S"]:
    params = scene.params
    exposure = params.shutter / params.fps
    rolling = params.rolling_shutter
    readout = 0.0 if rolling is None else rolling.readout / params.fps
    return scene.timestamps[:, None] + instants_of_frame(params.instants, exposure, readout)


def _instants(
    scene: Set, times_of_frames: Float[Tensor, "F S"]
) -> Iterator[Float32[np.ndarray, "H W 4"]]:
    """Light of the whole picture at each instant, and the person's coverage as fourth channel."""
    moves, times = _moves_at(scene, times_of_frames), times_of_frames.flatten()
    viewmats = scene.camera.viewmats(times)
    transforms = joint_transforms(
        scene.body, scene.betas.double(), moves.global_orient, moves.body_pose, moves.transl
    ).numpy()
    others = [] if scene.passer_by is None else scene.passer_by.instants(times)
    mesh = scene.person.mesh
    width, height = scene.params.size
    for index, vertices in enumerate(scene.person.posed(moves)):
        viewmat = viewmats[index].double().numpy()
        view = View(scene.K.double().numpy(), viewmat, width, height, scene.params.samples_per_axis)
        picture = np.zeros((height, width, 4), np.float32)
        picture[..., :3] = draw_backdrop(scene.backdrop, view.K, viewmat, (width, height))
        passer = scene.passer_by
        if passer is not None and not passer.in_front:
            picture = _over(picture, _drawn(others[index], passer.person.mesh, view))
        if scene.prop is None:
            layer = _drawn(vertices, mesh, view)
            layer[..., 4] = layer[..., 3]
        else:
            layer = _with_prop(scene.prop, vertices, mesh, transforms[index], view)
        picture = _over(picture, layer)
        if passer is not None and passer.in_front:
            picture = _over(picture, _drawn(others[index], passer.person.mesh, view))
        yield picture


def _moves_at(scene: Set, times_of_frames: Float[Tensor, "F S"]) -> Moves:
    """Poses at unevenly spaced times: the cloth's swing is followed on an even grid.

    Its step is that of a frame's instants: those of neighbouring frames may overlap.
    """
    times = times_of_frames.flatten()
    moves = move(scene.params.motion, times, scene.seconds)
    unfitted = scene.params.unfitted_body
    if unfitted is None or unfitted.swing == 0:
        return moves
    step = float(times_of_frames.diff(dim=int(times_of_frames.shape[1] > 1)).min())
    grid = torch.arange(math.ceil(float(times[-1] - times[0]) / step) + 2) * step + times[0]
    swing = scene.moves(grid).swing
    nearest = ((times - times[0]) / step).round().long()
    return Moves(
        moves.global_orient,
        moves.body_pose,
        moves.transl,
        None if swing is None else swing[nearest],
    )


def _drawn(
    vertices: Float32[np.ndarray, "P 3"], mesh: TexturedMesh, view: View
) -> Float32[np.ndarray, "H W 5"]:
    """Premultiplied light, coverage, and none of it the person's."""
    picture = render(vertices, mesh, view, LIGHTING)
    nobody = np.zeros_like(picture.coverage)
    return np.dstack([picture.light, picture.coverage, nobody])


def _with_prop(
    prop: HeldProp,
    vertices: Float32[np.ndarray, "P 3"],
    mesh: TexturedMesh,
    transforms: Float[np.ndarray, "J 4 4"],
    view: View,
) -> Float32[np.ndarray, "H W 5"]:
    """Person and prop before and behind each other; the person's part is seen in white light."""
    both = np.concatenate([vertices, prop.placed(transforms)])
    layer = _drawn(both, joined(mesh, prop.mesh, len(vertices)), view)
    white = TexturedMesh(mesh.faces, np.ones_like(mesh.albedo))
    black = TexturedMesh(prop.mesh.faces, np.zeros_like(prop.mesh.albedo))
    layer[..., 4] = render(both, joined(white, black, len(vertices)), view, WHITE).light[..., 0]
    return layer


def _over(
    behind: Float32[np.ndarray, "H W 4"], layer: Float32[np.ndarray, "H W 5"]
) -> Float32[np.ndarray, "H W 4"]:
    """A layer before what was there: light, and the person's coverage."""
    return behind * (1 - layer[..., 3:4]) + layer[..., [0, 1, 2, 4]]
