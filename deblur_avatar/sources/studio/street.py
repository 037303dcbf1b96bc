"""Street source: a synthetic person filmed as people film, through a video file, all truth known.

Conventions. The clip's world is the recorded camera's, as in `monocular`: the camera's way is given
to the body. Test cameras stand around the person in the studio's world; `Reference.viewmats` has
them in the clip's.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from pydantic import Field
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import FilmedTruth, Reference
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.config.section import Count, Params
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.imaging.video_writing import write_video
from deblur_avatar.rendering.mesh_rendering import View, render
from deblur_avatar.rendering.visibility import seen_cells, seen_pixels
from deblur_avatar.sources.given_poses import before_still_camera
from deblur_avatar.sources.monocular import MonocularParams, load_monocular
from deblur_avatar.sources.source import Segment
from deblur_avatar.sources.studio.cameras import place_cameras
from deblur_avatar.sources.studio.filming import Set, Take, build_set, film
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.source import LIGHTING, SEEN_CELLS, SUBFRAMES, encode
from deblur_avatar.sources.studio.street_params import EncodingParams, FilmParams

GUESSED_VIEW, GUESSED_SHUTTER = 60.0, 0.5  # what is taken for one's own video: docs


class StreetParams(Params):
    """A video that the studio wrote, read as one's own.

    `given` says what comes along with the file: nothing, or true mattes, poses and focal length.
    """

    source: Literal["street"]
    film: FilmParams
    given: Literal["nothing", "everything"]
    test_cameras: Count
    test_stride: Count  # frames from one test view to the next
    test_size: Annotated[int, Field(ge=8)]  # square, pixels

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Film, write the file, read it."""
        return load_street(self, body, segment)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """None: everything is made here."""
        return ()


def load_street(params: StreetParams, body: Body, segment: Segment) -> tuple[Clip, Reference]:
    """Film the scene, write it to a file, and read that as anybody's video.

    Args:
        params: of the scene.
        body: whose joints the person has.
        segment: finds the person where the focal length is to be estimated.

    Raises:
        ConfigError: if the motion is not known.
    """
    # Its own seed, not the scene's: scenes that differ in what is given are of the same film.
    generator = torch.Generator().manual_seed(params.film.seed)
    scene = build_set(params.film, body, generator)
    return read_take(params, scene, film(scene, generator), body, segment)


def read_take(
    params: StreetParams, scene: Set, take: Take, body: Body, segment: Segment
) -> tuple[Clip, Reference]:
    """Write what was filmed to a file, read that, and add what is given; as `load_street`."""
    with tempfile.TemporaryDirectory(prefix="street-") as folder:
        path = write_take(take, Path(folder), params.film.encoding, params.film.fps)
        clip, _ = load_monocular(_reading(path, params.film), body, segment)
    viewmats = scene.camera.viewmats(scene.timestamps).float()
    ring = place_cameras(params.test_cameras, params.test_size)
    clip = replace(clip, cameras=_with_test_cameras(clip.cameras, ring, viewmats[0]))
    if params.given == "everything":
        poses = _poses(scene, scene.moves(scene.timestamps), viewmats)
        cameras = replace(clip.cameras, Ks=torch.cat([scene.K[None], clip.cameras.Ks[1:]]))
        exposure = params.film.shutter / params.film.fps
        clip = replace(
            clip, mattes=take.mattes[None], initial=poses, cameras=cameras, exposure=exposure,
            exposure_std=None,
        )  # fmt: skip
    return clip, _reference(params, scene, take, ring, viewmats)


def write_take(take: Take, folder: Path, encoding: EncodingParams | None, fps: float) -> Path:
    """Write frames as a video, or without loss as pictures; returns the file or folder."""
    pictures = [frame.numpy() for frame in take.frames]
    if encoding is not None:
        path = folder / "street.mp4"
        write_video(path, pictures, fps, encoding.quality)
        return path
    for index, picture in enumerate(pictures):
        write_picture(folder / f"{index:05d}.png", picture)
    return folder


def _reading(path: Path, film: FilmParams) -> MonocularParams:
    """Nothing but the file is known; the frame rate is that of a folder."""
    return MonocularParams(
        source="monocular", path=str(path), frames=(0, None), stride=1, fps=film.fps,
        image_height=film.size[1], focal="estimated", field_of_view=GUESSED_VIEW,
        exposure_s="estimated", shutter=GUESSED_SHUTTER, averaging_space="linear", held_out=0.0,
        keypoints=None, masks=None, poses=None,
    )  # fmt: skip


def _with_test_cameras(filmed: Cameras, ring: Cameras, viewmat: Float[Tensor, "4 4"]) -> Cameras:
    """The recorded camera, then the test cameras, as they stand at the first frame."""
    from_clip = torch.linalg.inv(viewmat)
    return Cameras(
        Ks=torch.cat([filmed.Ks, ring.Ks[1:]]),
        viewmats=torch.cat([filmed.viewmats, ring.viewmats[1:] @ from_clip]),
        distortion=torch.zeros(len(ring.Ks), 5),
        sizes=torch.cat([filmed.sizes, ring.sizes[1:]]),
        names=(filmed.names[0], *ring.names[1:]),
    )


def _poses(scene: Set, moves: Moves, viewmats: Float[Tensor, "M 4 4"]) -> Poses:
    """True poses in the recorded camera's axes."""
    return before_still_camera(
        moves.poses(scene.betas), viewmats, shaped_joints(scene.body, scene.betas)[0]
    )


def _reference(
    params: StreetParams,
    scene: Set,
    take: Take,
    ring: Cameras,
    viewmats: Float[Tensor, "F 4 4"],
) -> Reference:
    """Sharp views of the person without street or prop, and the truth of every estimated step."""
    testing = list(range(0, params.film.frames, params.test_stride))
    seen = _seen_cells(scene, viewmats)
    faces, images, masks, stood = scene.person.mesh.faces, [], [], []
    shown = [vertices for f, vertices in enumerate(_instants(scene)) if f in testing]
    for camera in run.progress(range(1, len(ring.Ks)), "filming the truth"):
        view = View.of(ring, camera, 3)
        for frame, vertices in zip(testing, shown, strict=True):
            images.append(encode(render(vertices, scene.person.mesh, view, LIGHTING)))
            masks.append(np.uint8(255) * seen_pixels(vertices, faces, view, seen))
            stood.append(ring.viewmats[camera] @ torch.linalg.inv(viewmats[frame]))
    views = torch.from_numpy(np.stack(images))
    instants = SUBFRAMES * (params.film.frames - 1) + 1
    subtimes = torch.arange(instants, dtype=torch.float64) / (SUBFRAMES * params.film.fps)
    fine = _poses(scene, scene.moves(subtimes), scene.camera.viewmats(subtimes).float())
    return Reference(
        images=views[..., :3],
        mattes=views[..., 3],
        seen=torch.from_numpy(np.stack(masks)),
        camera_indices=torch.arange(1, len(ring.Ks)).repeat_interleave(len(testing)),
        frame_indices=torch.tensor(testing).repeat(len(ring.Ks) - 1),
        novel_pose=torch.zeros(len(views), dtype=torch.long),
        background=(0.0, 0.0, 0.0),
        motion_times=subtimes.float(),
        motion=fine,
        viewmats=torch.stack(stood),
        filmed=FilmedTruth(mattes=take.mattes, focal=float(scene.K[0, 0])),
    )


def _instants(scene: Set) -> list[Float32[np.ndarray, "P 3"]]:
    """The person at the middle of every frame."""
    return list(scene.person.posed(scene.moves(scene.timestamps)))


def _seen_cells(scene: Set, viewmats: Float[Tensor, "F 4 4"]) -> Bool[np.ndarray, "T R R"]:
    """What of the surface the camera saw in any frame, wherever it stood."""
    faces = scene.person.mesh.faces
    width, height = scene.params.size
    K = scene.K.double().numpy()
    seen = np.zeros((len(faces), SEEN_CELLS, SEEN_CELLS), bool)
    for vertices, viewmat in zip(_instants(scene), viewmats.double().numpy(), strict=True):
        view = View(K, viewmat, width, height, 1)
        seen |= seen_cells([vertices], faces, view, SEEN_CELLS)
    return seen
