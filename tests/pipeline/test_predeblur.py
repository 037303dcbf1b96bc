import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.imaging.deblurring.dstnet_small import SHIPPED
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.pipeline.predeblur import PredeblurParams, clips_of, predeblur
from deblur_avatar.pipeline.score_predeblur import score_predeblur

MATTE = {
    "kind": "matte", "lengths": (3.0, 5.0), "angles": 4, "regularisation": 0.002,
    "window_sigma": 3.0, "gain": 0.05,
}  # fmt: skip
PARAMS = PredeblurParams(given="", deblurrer=MATTE)


def smeared(stack: torch.Tensor, length: int = 5) -> torch.Tensor:
    """Blurred along the rows."""
    shifts = range(-(length // 2), length // 2 + 1)
    moved = torch.stack([torch.roll(stack.float(), shift, 2) for shift in shifts])
    return moved.mean(0).round().to(torch.uint8)


@pytest.fixture
def sharp(make_observations):
    """A grey, striped disc instead of a person."""
    y, x = torch.meshgrid(torch.arange(64), torch.arange(64), indexing="ij")
    disc = ((x - 32) ** 2 + (y - 32) ** 2 < 18**2).to(torch.uint8)
    picture = (disc * (150 + 60 * (x % 16 > 7)).to(torch.uint8))[..., None]
    return dataclasses.replace(
        make_observations(frames=4, size=64),
        mattes=(255 * disc).expand(4, 64, 64).contiguous(),
        frames=picture.expand(4, 64, 64, 3).contiguous(),
    )


@pytest.fixture
def blurred(sharp):
    return dataclasses.replace(sharp, frames=smeared(sharp.frames), mattes=smeared(sharp.mattes))


def test_frames_and_mattes_come_closer_to_the_sharp_ones(sharp, blurred, tmp_path):
    made, used = predeblur(blurred, PARAMS)
    sharp.save(tmp_path / "sharp")
    scores = score_predeblur(made, blurred, tmp_path / "sharp")
    assert used["method"] == "matte"
    assert 0 < used["streak_px"] <= 5
    for key in ("psnr", "psnr_person", "psnr_matte"):
        assert scores[f"{key}_deblurred"] > scores[f"{key}_blurred"] + 1.0


def test_all_but_the_pictures_is_as_it_was_and_the_exposure_is_nothing(blurred):
    made, _ = predeblur(blurred, PARAMS)
    assert made.exposure == 0.0
    assert made.train == blurred.train
    assert torch.equal(made.poses.body_pose, blurred.poses.body_pose)
    far = torch.nn.functional.max_pool2d(blurred.mattes.float()[:, None], 41, 1, 20)[:, 0] == 0
    assert torch.equal(made.frames[far], blurred.frames[far])


def test_light_that_was_averaged_linearly_is_sharpened_linearly(blurred):
    linear = dataclasses.replace(blurred, averaging_space="linear")
    one, _ = predeblur(blurred, PARAMS)
    other, _ = predeblur(linear, PARAMS)
    assert torch.equal(one.mattes, other.mattes)
    assert not torch.equal(one.frames, other.frames)


def test_given_frames_are_taken_as_they_are(sharp, blurred, tmp_path, monkeypatch):
    for index, frame in enumerate(sharp.frames):
        write_picture(tmp_path / f"{index:06d}.png", frame.numpy())
    monkeypatch.setenv("DEBLURRED_ELSEWHERE", str(tmp_path))
    params = PARAMS.model_copy(update={"given": "${DEBLURRED_ELSEWHERE:-}"})
    made, used = predeblur(blurred, params)
    assert used == {"method": "given"}
    assert torch.equal(made.frames, sharp.frames)
    assert torch.equal(made.mattes, blurred.mattes)
    monkeypatch.setenv("DEBLURRED_ELSEWHERE", "")
    assert predeblur(blurred, params)[1]["method"] == "matte"


@pytest.mark.parametrize(
    ("count", "size", "complaint"),
    [(3, 64, "predeblur.given: .* holds 3"), (4, 32, "32 x 32 pixels")],
)
def test_given_frames_must_be_those_of_the_observations(blurred, tmp_path, count, size, complaint):
    for index in range(count):
        write_picture(tmp_path / f"{index}.png", np.zeros((size, size, 3), np.uint8))
    with pytest.raises(ArtifactError, match=complaint):
        predeblur(blurred, PARAMS.model_copy(update={"given": str(tmp_path)}))


def test_fitted_frames_are_deblurred_without_those_that_are_kept_from_fitting(blurred):
    assert clips_of(dataclasses.replace(blurred, train=(0, 2), validation=(1,))) == [
        slice(0, 3), slice(3, 4),
    ]  # fmt: skip
    assert clips_of(dataclasses.replace(blurred, train=(2, 3), validation=())) == [
        slice(0, 2), slice(2, 4),
    ]  # fmt: skip
    assert clips_of(dataclasses.replace(blurred, train=(0, 1, 2, 3), validation=())) == [
        slice(0, 4)
    ]


@pytest.mark.skipif(not SHIPPED.is_dir(), reason="no weights are shipped yet: experiments/dstnet")
def test_the_network_that_is_shipped_sharpens_a_section_that_asks_for_it(blurred):
    """As a user asks for it: by a section of parameters alone."""
    network = {"kind": "dstnet_small", "weights": "", "frames_at_once": 30}
    params = parse(PredeblurParams, {"given": "", "deblurrer": network}, "predeblur.here")
    made, used = predeblur(blurred, params)
    assert used["method"] == "dstnet_small"
    assert made.exposure == 0.0
    assert made.frames.shape == blurred.frames.shape
    assert not torch.equal(made.frames, blurred.frames)


@pytest.mark.parametrize(
    ("deblurrer", "complaint"),
    [
        ({"kind": "magic"}, "no kind of this name, there is matte, dstnet_small"),
        ({"kind": "dstnet_small", "weights": ""}, "missing key 'deblurrer.frames_at_once'"),
        ({**MATTE, "angles": 0}, "angles"),
    ],
)
def test_a_deblurrer_that_is_none_is_refused(deblurrer, complaint):
    with pytest.raises(ConfigError, match=complaint):
        parse(PredeblurParams, {"given": "", "deblurrer": deblurrer}, "predeblur.here")


def test_without_sharp_frames_nothing_is_measured(blurred, tmp_path):
    assert set(score_predeblur(blurred, blurred, tmp_path / "sharp").values()) == {None}
