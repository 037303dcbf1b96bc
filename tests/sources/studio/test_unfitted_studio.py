import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.sources.studio.cameras import RingParams
from deblur_avatar.sources.studio.sensor import NoiseParams
from deblur_avatar.sources.studio.source import BETAS, SUBFRAMES, StudioParams, load_studio
from deblur_avatar.sources.studio.texture import LookParams
from deblur_avatar.sources.studio.unfitted_body import UnfittedParams
from deblur_avatar.sources.studio.unfitted_studio import (
    UnfittedStudioParams,
    load_unfitted_studio,
)

SHARED = {
    "motion": "turn", "frames": 4, "fps": 60.0, "image_size": 16, "test_cameras": 3,
    "test_stride": 2, "window": 5, "samples_per_axis": 1, "noise_degrees": 1.5, "noise_mm": 5.0,
    "noise_correlation_s": 0.1, "held_out": 0.25,
}  # fmt: skip
OFF = UnfittedStudioParams(
    source="unfitted_studio", seed=3, start=0.0, turns=0.0, betas=BETAS, betas_error=0.0,
    look=None, ring=None, unfitted_body=None, noise=None, **SHARED,
)  # fmt: skip


def filmed(body: Body, **changes: object) -> tuple[Clip, Reference]:
    return load_unfitted_studio(OFF.model_copy(update=changes), body)


@pytest.fixture(scope="module")
def plain(body: Body) -> tuple[Clip, Reference]:
    return filmed(body)


def same(a: object, b: object) -> bool:
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    return a == b


def test_with_everything_off_it_is_the_studio_bit_by_bit(body: Body, plain):
    studio = StudioParams(source="studio", **SHARED)
    clip, reference = load_studio(studio, body, torch.Generator().manual_seed(OFF.seed))
    assert same(plain[0], clip)
    assert same(plain[1], reference)


def test_the_same_seed_films_the_same_scene(body: Body):
    changes = {"noise": NoiseParams(shot=4e-4, read=0.004), "betas_error": 0.5}
    assert same(filmed(body, **changes)[0], filmed(body, **changes)[0])
    assert not same(filmed(body, **changes)[0], filmed(body, **changes, seed=4)[0])


def test_scenes_of_another_window_show_the_same_person_in_the_same_poses(body: Body, plain):
    wider = filmed(body, window=9)[0]
    assert torch.equal(wider.frames, plain[0].frames)
    assert same(wider.initial, plain[0].initial)
    assert not torch.equal(wider.true_blur_linear[0], plain[0].true_blur_linear[0])


def test_the_shape_that_is_given_is_wrong_and_the_exact_one_is_not(body: Body, plain):
    clip, reference = filmed(body, betas_error=0.5)
    assert torch.equal(clip.exact.betas, plain[0].exact.betas)
    assert torch.equal(reference.motion.betas, plain[0].exact.betas)
    error = clip.initial.betas - clip.exact.betas
    assert float(error.norm()) == pytest.approx(0.5, rel=1e-5)
    assert torch.equal(clip.initial.body_pose, plain[0].initial.body_pose)


def test_noise_is_the_training_camera_s_and_only_where_the_person_is(body: Body, plain):
    clip, reference = filmed(body, noise=NoiseParams(shot=4e-3, read=0.01))
    assert torch.equal(reference.images, plain[1].images)
    for noisy, clean, mattes in (
        (clip.frames[0], plain[0].frames[0], clip.mattes[0]),
        (clip.true_blur_linear, plain[0].true_blur_linear, clip.true_blur_mattes),
        (clip.true_blur_srgb, plain[0].true_blur_srgb, clip.true_blur_mattes),
    ):
        assert not torch.equal(noisy, clean)
        assert int(noisy[mattes == 0].max()) == 0
        away = (noisy.float() - clean.float())[mattes == 255]
        assert 1 < float(away.std()) < 60


def test_an_unfitted_body_is_seen_and_the_poses_stay(body: Body, plain):
    unfitted = UnfittedParams(shape_mm=8.0, weight_rounds=6, swing=1.0, hair_mm=25.0)
    clip, reference = filmed(body, unfitted_body=unfitted)
    assert same(clip.exact, plain[0].exact)
    assert not torch.equal(reference.images, plain[1].images)


def test_swinging_cloth_is_the_same_in_frames_and_test_views(body: Body):
    """A test view at a training frame shows the cloth that the frame shows."""
    ring = RingParams(training_height=1.0, test_heights=(1.0,), test_degrees=-180.0, field=2.12)
    loose = UnfittedParams(shape_mm=0.0, weight_rounds=0, swing=1.0, hair_mm=0.0)
    changes = {"test_cameras": 1, "ring": ring, "image_size": 48}
    clip, reference = filmed(body, unfitted_body=loose, **changes)
    frame = int(reference.frame_indices[0])
    assert torch.equal(reference.images[0], clip.frames[0][frame])
    still, _ = filmed(body, **changes)
    assert not torch.equal(still.frames[0][frame], clip.frames[0][frame])


@pytest.mark.parametrize(
    "change", [{"dye": (2, 0, 1)}, {"wider": 2.0}, {"print_depth": 0.4}, {"tan": 0.3}], ids=str
)
def test_another_look_changes_colours_and_nothing_else(body: Body, plain, change):
    own = {"dye": (0, 1, 2), "wider": 1.0, "print_depth": 0.0, "print_m": 0.05, "tan": 0.0}
    _, reference = filmed(body, look=LookParams(**own | change))
    assert torch.equal(reference.mattes, plain[1].mattes)
    assert not torch.equal(reference.images, plain[1].images)


def test_a_look_that_changes_nothing_is_the_studio_s(body: Body, plain):
    same_look = LookParams(dye=(0, 1, 2), wider=1.0, print_depth=0.0, print_m=0.05, tan=0.0)
    assert torch.equal(filmed(body, look=same_look)[1].images, plain[1].images)


def test_a_wider_field_makes_the_person_smaller(body: Body, plain):
    ring = RingParams(training_height=1.0, test_heights=(0.7,), test_degrees=30.0, field=4.24)
    clip, _ = filmed(body, ring=ring)
    assert float((clip.mattes > 0).sum()) < 0.4 * float((plain[0].mattes > 0).sum())
    assert clip.cameras.Ks[0, 0, 0] == pytest.approx(float(plain[0].cameras.Ks[0, 0, 0]) / 2)


def test_a_motion_s_file_is_missed_before_any_work():
    there = OFF.model_copy(update={"motion": "builtin:jumping_jacks"})
    assert OFF.missing_files("clip") == there.missing_files("clip") == ()
    gone = OFF.model_copy(update={"motion": "$(NO_SUCH_VARIABLE:-nowhere/dance.bvh)"})
    (reason,) = gone.missing_files("scenes.dance.clip")
    assert reason == "no motion file nowhere/dance.bvh (scenes.dance.clip.motion)"


def test_a_built_in_motion_stands_on_the_floor_and_turns(body: Body):
    clip, reference = filmed(body, motion="builtin:jumping_jacks", turns=0.5, frames=16)
    assert len(reference.motion_times) == 15 * SUBFRAMES + 1
    assert not torch.equal(clip.exact.body_pose[0], clip.exact.body_pose[8])
    heading = clip.exact.global_orient[:, 1]
    assert float(heading[8] - heading[0]) == pytest.approx(torch.pi / 2, abs=0.05)
