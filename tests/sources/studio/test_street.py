from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.cameras import project
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.sources.studio.filming import Take, build_set, film
from deblur_avatar.sources.studio.street import StreetParams, load_street, read_take
from deblur_avatar.sources.studio.street_params import FilmParams

PLAIN: dict[str, object] = {
    "seed": 0, "motion": "turn", "frames": 3, "fps": 10.0, "shutter": 0.5, "instants": 3,
    "size": [64, 48], "field_of_view": 60.0, "samples_per_axis": 1, "unfitted_body": None,
    "backdrop": None, "hand_held": None, "noise": None, "encoding": None, "exposure_drift": None,
    "rolling_shutter": None, "passer_by": None, "held_prop": None,
}  # fmt: skip
OPTIONS: dict[str, object] = {
    "unfitted_body": {"shape_mm": 8.0, "weight_rounds": 4, "swing": 1.0, "hair_mm": 25.0},
    "backdrop": "street",
    "hand_held": {"sway_mm": 50.0, "shake_degrees": 1.0, "pan_degrees": 4.0, "walk_m": 0.0},
    "noise": {"shot": 4e-4, "read": 0.01},
    "encoding": {"quality": 30},
    "exposure_drift": {"stops": 0.5, "tint_stops": 0.1, "period_s": 0.5},
    "rolling_shutter": {"readout": 0.5},
    "passer_by": {"depth_m": 1.0, "speed_m_s": 1.0, "middle_s": 0.1},
    "held_prop": {"length_m": 0.7},
}


def params(given: str = "everything", **changes: object) -> StreetParams:
    asked = {
        "source": "street", "film": PLAIN | changes, "given": given, "test_cameras": 2,
        "test_stride": 2, "test_size": 24,
    }  # fmt: skip
    return parse(ClipParams, asked, "scenes.street.clip")


def take(body: Body, **changes: object) -> Take:
    asked: FilmParams = params(**changes).film
    generator = torch.Generator().manual_seed(asked.seed)
    return film(build_set(asked, body, generator), generator)


def everyone_is_in_the_middle(frames: torch.Tensor) -> torch.Tensor:
    mattes = torch.zeros(frames.shape[:3], dtype=torch.uint8)
    mattes[:, 10:40, 20:44] = 255
    return mattes


@pytest.fixture(scope="module")
def plain(body: Body) -> Take:
    return take(body)


@pytest.fixture(scope="module")
def with_option(body: Body) -> Callable[[str], Take]:
    """The take with one option, made once."""
    return cache(lambda option: take(body, **{option: OPTIONS[option]}))


@pytest.fixture(scope="module")
def given(body: Body) -> tuple[Clip, Reference]:
    changes = {"hand_held": OPTIONS["hand_held"]}
    asked = params(**changes)
    return load_street(asked, body, everyone_is_in_the_middle)


def test_without_options_a_person_stands_on_black(plain: Take):
    assert plain.frames.shape == (3, 48, 64, 3)
    assert (plain.frames[plain.mattes == 0] == 0).all()
    assert (plain.mattes > 127).float().mean() > 0.03


@pytest.mark.parametrize("option", [name for name in OPTIONS if name != "encoding"])
def test_every_option_changes_the_film_and_is_off_by_itself(
    body: Body, plain: Take, with_option: Callable[[str], Take], option: str
):
    changed = with_option(option)
    assert not torch.equal(changed.frames, plain.frames)
    again = take(body, **{option: OPTIONS[option]})
    assert torch.equal(changed.frames, again.frames)
    assert torch.equal(changed.mattes, again.mattes)


@pytest.mark.parametrize("option", ["backdrop", "noise", "exposure_drift"])
def test_what_is_not_the_person_s_leaves_her_matte_alone(
    plain: Take, with_option: Callable[[str], Take], option: str
):
    assert torch.equal(with_option(option).mattes, plain.mattes)


@pytest.mark.parametrize("option", ["passer_by", "held_prop"])
def test_what_comes_before_the_person_is_cut_out_of_her_matte(
    plain: Take, with_option: Callable[[str], Take], option: str
):
    changed = with_option(option)
    less = plain.mattes.int() - changed.mattes.int()
    assert less.min() >= 0
    shown = (changed.frames.int() - plain.frames.int()).abs().amax(-1) > 20
    assert shown[plain.mattes == 0].any()  # beside her, and not in her matte
    assert changed.mattes[(plain.mattes == 0) & shown].max() == 0
    if option == "passer_by":
        assert less.max() > 200


def test_a_passer_by_behind_her_hides_nothing_of_her(body: Body, plain: Take):
    behind = {"depth_m": -1.0, "speed_m_s": 1.0, "middle_s": 0.1}
    changed = take(body, passer_by=behind)
    assert torch.equal(changed.mattes, plain.mattes)
    inside = plain.mattes == 255
    assert torch.equal(changed.frames[inside], plain.frames[inside])
    assert not torch.equal(changed.frames, plain.frames)


def test_true_poses_lie_on_the_person_whatever_way_the_camera_went(
    given: tuple[Clip, Reference], body: Body
):
    clip, _ = given
    joints = posed(body, clip.initial).joints
    for frame, matte in zip(joints, clip.mattes[0], strict=True):
        pixels, depth = project(frame, clip.cameras.Ks[0], clip.cameras.viewmats[0])
        assert depth.min() > 3
        x, y = pixels[:16].long().T  # arms and hands are thinner than a pixel
        assert (matte[y, x] > 60).float().mean() > 0.9


def test_test_cameras_see_the_person_in_the_clip_s_world(given: tuple[Clip, Reference], body: Body):
    clip, reference = given
    joints = posed(body, clip.initial).joints
    for view, frame in enumerate(reference.frame_indices.tolist()):
        camera = int(reference.camera_indices[view])
        lens = clip.cameras.Ks[camera], reference.viewmats[view]
        pixels, _ = project(joints[frame, :16], *lens)
        x, y = pixels.long().T
        assert (reference.mattes[view][y, x] > 60).float().mean() > 0.9
    assert set(reference.camera_indices.tolist()) == {1, 2}


def test_the_truth_of_every_step_comes_with_it(given: tuple[Clip, Reference]):
    clip, reference = given
    assert torch.equal(reference.filmed.mattes, clip.mattes[0])
    assert reference.filmed.focal == pytest.approx(32 / np.tan(np.pi / 6), rel=1e-5)
    assert float(reference.motion_times[-1]) == pytest.approx(0.2)
    assert (reference.seen == 255).any()


def test_with_nothing_given_only_the_file_is_known(body: Body):
    asked = params(given="nothing", encoding={"quality": 20})
    scene = build_set(asked.film, body, torch.Generator().manual_seed(0))
    filmed = film(scene, torch.Generator().manual_seed(0))
    clip, reference = read_take(asked, scene, filmed, body, everyone_is_in_the_middle)
    assert clip.blurred
    assert (clip.initial, clip.mattes, clip.landmarks) == (None, None, None)
    assert clip.exposure == pytest.approx(1 / 48)  # a guess: half of a 24th of a second, no more
    assert clip.exposure_std is not None
    assert reference.filmed is not None
    away = (clip.frames[0].float() - filmed.frames.float()).abs().mean()
    assert 0 < away < 6  # what the encoder lost
    assert clip.cameras.names == ("camera", "test1", "test2")


def test_what_is_given_is_no_guess(given: tuple[Clip, Reference]):
    assert given[0].exposure_std is None


def test_exposures_of_neighbouring_frames_may_overlap(body: Body, with_option):
    """A shutter that is hardly shut, rows read one after the other: times go back at a frame."""
    unfitted = OPTIONS["unfitted_body"]
    longer = take(body, unfitted_body=unfitted, rolling_shutter={"readout": 0.4}, shutter=1.0)
    assert len(longer.frames) == len(with_option("unfitted_body").frames)
    assert (longer.mattes > 0).sum() > (with_option("unfitted_body").mattes > 0).sum()


def test_a_coarser_encoding_loses_more(body: Body, plain: Take):
    lost = []
    for quality in (10, 45):
        asked = params(given="nothing", encoding={"quality": quality})
        scene = build_set(asked.film, body, torch.Generator().manual_seed(0))
        clip, _ = read_take(asked, scene, plain, body, everyone_is_in_the_middle)
        lost.append(float((clip.frames[0].float() - plain.frames.float()).abs().mean()))
    assert lost[1] > 1.5 * lost[0]


def test_a_body_that_is_not_the_fitter_s_keeps_its_joints(body: Body):
    asked = params(unfitted_body=OPTIONS["unfitted_body"]).film
    scene = build_set(asked, body, torch.Generator().manual_seed(0))
    assert torch.equal(scene.person.body.joints, body.joints)
    assert not torch.equal(scene.person.body.lbs_weights, body.lbs_weights)


def test_an_unknown_option_and_an_unknown_motion_are_refused(body: Body):
    with pytest.raises(ConfigError, match="backdrop"):
        params(backdrop="beach")
    with pytest.raises(ConfigError, match="no motion 'fly'"):
        take(body, motion="fly")
