"""A person of capsules in front of one camera: the smallest thing that can be fitted."""

import copy
import dataclasses
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jaxtyping
import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars import plain_avatar
from deblur_avatar.avatars.plain_avatar import PlainAvatar, PlainParams
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.config.reading import parse, read_yaml
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.motion.frame import FixedMotion
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams
from tests.exports.browser import chromium
from tests.filmed_scene import Scene, film

HERE = Path(__file__).parent
# Folders whose tests take longest begin first: a worker that is left alone at the end has short
# ones. Those that start many processes, and wait for them, before those that compute.
FIRST = ("sweep", "stages", "stress", "exports", "fuzz", "sources", "structure", "pipeline")

SIZE = 24  # pixels
# Calls of functions whose shapes are checked: the first of each test, and of later ones every so
# many, a prime, so that it is not always the same one of a loop's.
ALL_CHECKED, CHECKED_EVERY = 500, 29

PLAIN = PlainParams(kind="plain")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file without such a test for `-m portable`, four of five: half of its start."""
    if config.option.markexpr == "portable" and collection_path.name.startswith("test_"):
        return "mark.portable" not in collection_path.read_text() or None
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put long tests first, the tests of a file together."""
    rank = {name: number for number, name in enumerate(FIRST)}
    items.sort(key=lambda item: rank.get(item.path.relative_to(HERE).parts[0], len(FIRST)))


@pytest.fixture(scope="session", autouse=True)
def quick_processes() -> None:
    """Shapes are checked where tests run, not in processes that they start: each would take 2.6 s
    more to import what it needs.
    """
    os.environ.pop("DEBLUR_AVATAR_CHECK_SHAPES", None)


class SampledChecks(type(jaxtyping.config)):  # type: ignore[misc]
    """Shapes are checked in a test's first calls and in some of all later ones: most of those call
    what the ones before called, and checking each takes a fifth of the time of such tests.
    """

    calls = 0  # of functions with annotated shapes, the fixtures' included
    switched_off = False

    @property
    def jaxtyping_disable(self) -> bool:
        """Asked by every call whether it is not checked."""
        self.calls += 1
        left_out = self.calls > ALL_CHECKED and self.calls % CHECKED_EVERY != 0
        return self.switched_off or left_out

    @jaxtyping_disable.setter
    def jaxtyping_disable(self, value: bool) -> None:
        self.switched_off = value


if os.environ.get("DEBLUR_AVATAR_CHECK_SHAPES") == "1":
    wanted = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.__class__ = SampledChecks
    jaxtyping.config.jaxtyping_disable = wanted


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Before a test's fixtures are made."""
    jaxtyping.config.calls = 0  # type: ignore[attr-defined]


@pytest.fixture(scope="session", autouse=True)
def bodies_looked_at_once() -> Iterator[None]:
    """What a plain avatar looks at its body for, half a second for each of them, is the same for
    every fit of that body, and is never changed.
    """
    look = plain_avatar.closure_views
    known: dict[tuple[Any, ...], Any] = {}

    def remembered(vertices: torch.Tensor, body: Body, nearer: dict[str, float]) -> Any:
        parts = (part.cpu().numpy().tobytes() for part in (vertices, body.faces, body.lbs_weights))
        asked = vertices.device, *nearer.items(), *parts
        if asked not in known:
            known[asked] = look(vertices, body, nearer)
        return known[asked]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain_avatar, "closure_views", remembered)
        yield


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """One Chromium for all tests of a process."""
    with chromium() as started:
        yield started


@pytest.fixture(scope="session")
def body() -> Body:
    return capsule_body()


def swinging_poses(body: Body, frames: int, degrees: float) -> Poses:
    """A person whose left arm swings at constant speed and who drifts sideways."""
    joints = len(body.parents)
    time = torch.linspace(-0.5, 0.5, frames)
    body_pose = torch.zeros(frames, joints - 1, 3)
    body_pose[:, 15, 2] = torch.deg2rad(torch.tensor(degrees)) * time * (frames - 1)
    transl = torch.stack([0.02 * time, 0 * time, 0 * time], 1)
    return Poses(
        betas=torch.zeros(body.shape_dirs.shape[2]),
        global_orient=torch.zeros(frames, 3),
        body_pose=body_pose,
        transl=transl,
    )


def camera(size: int = SIZE) -> Cameras:
    viewmat = look_at(torch.tensor([0.0, 0.0, 4.0]), torch.zeros(3), torch.tensor([0.0, 1.0, 0.0]))
    K = torch.tensor([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]])
    return Cameras(
        Ks=K[None],
        viewmats=viewmat[None],
        distortion=torch.zeros(1, 5),
        sizes=torch.tensor([[size, size]]),
        names=("front",),
    )


def colourful(
    body: Body, frames: int, count: int = 150, averaging_space: str = "srgb"
) -> PlainAvatar:
    """An avatar whose colours tell its parts apart."""
    generator = torch.Generator().manual_seed(3)
    model = PlainAvatar.create(
        PLAIN,
        body,
        torch.zeros(body.shape_dirs.shape[2]),
        frames,
        count,
        averaging_space,
        generator,
    )
    with torch.no_grad():
        gaussians = model.gaussians
        gaussians.features.copy_(4 * torch.sin(7 * gaussians.means))
        gaussians.opacity_logits.fill_(3.0)
        gaussians.log_scales.add_(0.3)
    return model


@pytest.fixture(scope="session")
def make_observations(body: Body) -> Callable[..., Observations]:
    def make(frames: int = 5, degrees: float = 8.0, size: int = SIZE) -> Observations:
        poses, cameras = swinging_poses(body, frames, degrees), camera(size)
        model = colourful(body, frames)
        images, alphas = render_avatar(model, poses, cameras.camera(0))
        return Observations(
            frames=(images * 255).round().to(torch.uint8),
            mattes=(alphas * 255).round().to(torch.uint8),
            comparable=None,
            backgrounds=None,
            cameras=cameras,
            crops=torch.tensor([[0.0, 0, size, size]]),
            train_camera=0,
            body=body,
            poses=poses,
            weights=torch.ones(frames),
            frame_indices=tuple(range(frames)),
            timestamps=torch.arange(frames) / 60,
            exposure=1 / 60,
            averaging_space="srgb",
            train=tuple(range(frames - 1)),
            validation=(frames - 1,),
            depth_known=True,
            pose_std=math.radians(1.5),
            occluded_fraction=0.5,
        )

    return make


@pytest.fixture(scope="session")
def observations(make_observations: Callable[..., Observations]) -> Observations:
    return make_observations()


@pytest.fixture
def sharpened(observations: Observations) -> Callable[..., Observations]:
    """The same observations with some fields replaced."""

    def replace(**changes: object) -> Observations:
        return dataclasses.replace(observations, **changes)

    return replace


@pytest.fixture(scope="session")
def front() -> Cameras:
    """The camera that `observations` were taken with."""
    return camera()


@pytest.fixture(scope="session")
def swinging(body: Body) -> Callable[[int, float], Poses]:
    """Poses of a person whose left arm swings by so many degrees from frame to frame."""

    def make(frames: int, degrees: float) -> Poses:
        return swinging_poses(body, frames, degrees)

    return make


@pytest.fixture(scope="session")
def painted(body: Body) -> Callable[..., PlainAvatar]:
    """The avatar that `observations` show, without any network."""

    def make(frames: int = 5, averaging_space: str = "srgb", count: int = 150) -> PlainAvatar:
        return colourful(body, frames, count, averaging_space)

    return make


@pytest.fixture(scope="session")
def tiny_parameters() -> dict[str, Any]:
    """What params.yaml holds, made so small that a whole fit takes a second; not to be changed."""
    content = read_yaml(Path(__file__).parents[1] / "params.yaml")
    model = content["avatars"]["paper"]["model"]
    model["nonrigid"] = {"bins": 4, "hidden": [8], "codes": 2}
    model["skinning"] = {"hidden": [16], "pretrain": 20}
    model["color"] = {"features": 4, "hidden": [8], "latent": 2, "view_noise_degrees": 45.0}
    surface = content["avatars"]["arah_small"]["model"]
    surface["sdf"]["pretrain"], surface["skinning"]["pretrain"] = 30, 30
    network = content["methods"]["paper"]["fusion"]["network"]
    network |= {"hidden": [8], "frame_codes": 4, "color_features": 4}
    ends = {"warmup": 6, "trajectory": 12, "fusion": 18}
    content["schedule"], content["snapshots"] = "tiny", 0
    content["schedules"] = {"tiny": ends | {"gaussians": 80, "image_height": SIZE, "levels": []}}
    for name in content["on_request"]:
        del content["scenes"][name]
    kept = content["scenes"]
    content["checks"], content["on_request"] = list(kept), []
    content["without_pictures"] = []
    for section in ("warmups", "runs", "learning_curves", "animations", "self_checks"):
        entries = content[section].items()
        content[section] = {name: entry for name, entry in entries if entry["scene"] in kept}
    return content


@pytest.fixture
def tiny_content(tiny_parameters: dict[str, Any]) -> dict[str, Any]:
    """The same, one's own to change."""
    return copy.deepcopy(tiny_parameters)


@pytest.fixture
def recipe(tiny_content: dict[str, Any]) -> RecipeParams:
    return parse(RecipeParams, tiny_content["avatars"]["paper"], "avatars.paper")


@pytest.fixture
def plain_recipe(tiny_content: dict[str, Any]) -> RecipeParams:
    """Of an avatar without networks, whose neighbours are not held alike."""
    content = tiny_content["avatars"]["lean"]
    weights = content["fitting"]["regularisers"]
    content["fitting"]["regularisers"] = dict.fromkeys(weights, 0.0)
    return parse(RecipeParams, content, "avatars.lean")


@pytest.fixture
def schedule(tiny_content: dict[str, Any]) -> ScheduleParams:
    return parse(ScheduleParams, tiny_content["schedules"]["tiny"], "schedules.tiny")


@pytest.fixture
def scene(
    painted: Callable[..., PlainAvatar], make_observations: Callable[..., Observations]
) -> Scene:
    """What the stages after fitting read."""
    return film(painted(frames=8), make_observations(frames=8))


def fine_avatar(body: Body) -> PlainAvatar:
    """Two thousand small Gaussians on the surface."""
    model = colourful(body, 5, count=2000)
    with torch.no_grad():
        model.gaussians.log_scales.clamp_(max=-3.7)  # 2.5 cm
    return model


def filmed_with(observations: Observations, model: PlainAvatar) -> Observations:
    """The same frames with this avatar in them."""
    images, alphas = render_avatar(model, observations.poses, observations.camera)
    return dataclasses.replace(
        observations,
        frames=(images * 255).round().to(torch.uint8),
        mattes=(alphas * 255).round().to(torch.uint8),
    )


@pytest.fixture(scope="session")
def filmed(make_observations: Callable[..., Observations], body: Body) -> Observations:
    """Observations of the fine avatar: what a perfect fit is."""
    return filmed_with(make_observations(size=96), fine_avatar(body))


@pytest.fixture(scope="session")
def motion(filmed: Observations) -> Motion:
    """How the person in `filmed` moved."""
    return FixedMotion(filmed.poses).to_artifact(filmed.poses.betas, filmed.timestamps)


@pytest.fixture
def avatar(body: Body) -> PlainAvatar:
    """The avatar in `filmed`, to be spoilt."""
    return fine_avatar(body)
