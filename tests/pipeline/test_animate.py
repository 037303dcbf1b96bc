import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.errors import ConfigError
from deblur_avatar.motion.frame import FixedMotion
from deblur_avatar.pipeline.animate import AnimationParams, animate, sheet_of
from tests.conftest import colourful

PARAMS = AnimationParams(
    scene="capsules", motion="builtin:jumping_jacks", start=0.0, seconds=1.0, fps=6.0,
    image_size=32, turns=1.0, travel=0.0, margin=0.1, backdrop=0.0,
)  # fmt: skip


def shown(body, observations, **changes):
    avatar = colourful(body, len(observations.frames), count=600).to_artifact(1)
    return animate(
        avatar,
        observations,
        FixedMotion(observations.poses).to_artifact(
            observations.poses.betas, observations.timestamps
        ),
        PARAMS.model_copy(update=changes),
        where="animations.test",
        device=torch.device("cpu"),
        progress=lambda items, _: items,
    )


def box(frame):
    """First and last row and column that the person covers well."""
    lit = np.argwhere(frame.numpy().max(-1) > 90)
    return lit.min(0), lit.max(0)


def test_every_frame_shows_the_whole_person_inside_its_margin(body, observations):
    frames = shown(body, observations)
    assert frames.shape == (7, 32, 32, 3)
    boxes = [box(frame) for frame in frames]
    assert min(low.min() for low, _ in boxes) >= 1
    assert max(high.max() for _, high in boxes) <= 30
    assert max((high - low).max() for low, high in boxes) >= 22  # and fills it at its largest


def test_arms_go_up_and_down(body, observations):
    frames = shown(body, observations, turns=0.0, seconds=1.1, fps=20.0)
    widths = [box(frame)[1][1] - box(frame)[0][1] for frame in frames]
    assert max(widths) > 1.5 * min(widths)
    tops = [box(frame)[0][0] for frame in frames]
    assert max(tops) - min(tops) >= 3


def test_the_same_call_gives_the_same_pictures(body, observations):
    first, second = (shown(body, observations, seconds=0.3) for _ in range(2))
    assert torch.equal(first, second)


def test_the_avatars_shape_is_kept_whatever_the_estimates_say(body, observations):
    thin = shown(body, observations, seconds=0.1)
    poses = dataclasses.replace(observations.poses, betas=torch.tensor([0.0, 5.0]))
    again = shown(body, dataclasses.replace(observations, poses=poses), seconds=0.1)
    assert torch.equal(thin, again)


def test_behind_the_person_is_the_grey_that_was_asked_for(body, observations):
    black, grey = (shown(body, observations, seconds=0.3, backdrop=b)[0].int() for b in (0.0, 0.5))
    assert (black[0, 0] == 0).all()
    assert (grey[0, 0] == 128).all()
    assert (grey >= black).all()
    inside = black.amax(-1) > 150
    assert (grey - black).abs()[inside].float().mean() < 12  # she is nearly opaque


def test_an_amass_file_drives_the_avatar(body, observations, tmp_path):
    poses = np.zeros((31, 156))
    poses[:, 0] = np.pi / 2  # upright in a world with +Z up
    poses[:, 3 + 15 * 3 + 2] = np.linspace(-1.2, 1.2, 31)  # the left arm goes up
    trans = np.zeros((31, 3))
    path = tmp_path / "arm.npz"
    np.savez(path, poses=poses, trans=trans, mocap_framerate=30.0)
    frames = shown(body, observations, motion=str(path), turns=0.0)
    hands = [box(frame[:, 19:])[0][0] for frame in frames]  # her left hand is on our right
    assert hands[0] >= hands[-1] + 5
    still = (frames[0, :, :13].int() - frames[-1, :, :13].int()).abs().float().mean()
    moved = (frames[0, :, 19:].int() - frames[-1, :, 19:].int()).abs().float().mean()
    assert moved > 5 * still


def test_a_path_may_come_from_the_environment(body, observations, monkeypatch):
    monkeypatch.delenv("DANCE", raising=False)
    with pytest.raises(ConfigError, match=r"animations\.test\.motion: set .* DANCE"):
        shown(body, observations, motion="${DANCE}")
    frames = shown(body, observations, motion="${DANCE:-builtin:jumping_jacks}", seconds=0.1)
    assert len(frames) == 1


def test_a_missing_motion_is_refused(body, observations):
    with pytest.raises(ConfigError, match=r"no motion file dance\.bvh"):
        shown(body, observations, motion="dance.bvh")


def test_a_walk_behind_the_camera_is_refused_with_the_key(body, observations, tmp_path):
    path = tmp_path / "walk.npz"
    poses = np.zeros((10, 72))
    poses[:, 0] = np.pi / 2
    trans = np.linspace(0, -40, 10)[:, None] * np.array([[0.0, 1.0, 0.0]])
    np.savez(path, poses=poses, trans=trans, mocap_framerate=10.0)
    with pytest.raises(ConfigError, match=r"animations\.test: .*lower animate\.travel"):
        shown(body, observations, motion=str(path), travel=1.0, turns=0.0)


def test_the_sheet_shows_twelve_moments_with_their_times():
    frames = torch.zeros(31, 16, 16, 3, dtype=torch.uint8)
    frames[:, ..., 0] = torch.arange(31, dtype=torch.uint8)[:, None, None] * 8
    sheet = sheet_of(frames, 30.0)
    reds = {int(v) for v in np.unique(sheet[..., 0][sheet[..., 1] == 0])}
    assert reds == {int(round(i)) * 8 for i in np.linspace(0, 30, 12)}
    assert sheet_of(frames[:3], 30.0).shape[1] < sheet.shape[1]


def test_the_filmed_motion_is_shown_at_any_frame_rate(body, observations):
    own = shown(body, observations, motion="own", turns=0.0, fps=120.0, seconds=10.0)
    assert len(own) == 9  # four steps of a sixtieth of a second
    moved = (own.int() - own[0].int()).abs().amax(-1).float()
    assert moved[-1].max() > 40
    # Her left arm, on our right, is what moves, a little more in every frame.
    assert moved[-1, :, 19:].sum() > 3 * moved[-1, :, :13].sum()
    assert (moved.flatten(1).sum(1).diff() > 0).all()
    with pytest.raises(ConfigError, match=r"lasts 0\.07 s, it cannot start at 3"):
        shown(body, observations, motion="own", start=3.0)
