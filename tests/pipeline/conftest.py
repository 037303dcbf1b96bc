"""What the stages after fitting read."""

from collections.abc import Callable

import pytest

from deblur_avatar.artifacts import Observations
from deblur_avatar.avatar.model import AvatarModel
from tests.filmed_scene import Scene, film


@pytest.fixture
def scene(
    painted: Callable[..., AvatarModel], make_observations: Callable[..., Observations]
) -> Scene:
    return film(painted(frames=8), make_observations(frames=8))
