import dataclasses

import pytest
import torch

from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.imaging.deblurring.deblurrer import MARGIN, Pictures
from deblur_avatar.imaging.deblurring.dstnet_small import DstnetSmallParams, pieces
from deblur_avatar.imaging.dstnet import Dstnet, DstnetParams
from deblur_avatar.imaging.dstnet_weights import DstnetWeights

SMALL = DstnetParams(features=4, blocks=1, refinements=1)


@pytest.fixture
def params(tmp_path) -> DstnetSmallParams:
    torch.manual_seed(1)
    network = Dstnet(SMALL)
    torch.nn.init.normal_(network.leave.weight, std=0.3)
    weights = DstnetWeights(
        recipe="{}", clips="", tensors=network.state_dict(), **SMALL.model_dump()
    )
    weights.save(tmp_path / "weights")
    return DstnetSmallParams(
        kind="dstnet_small", weights=str(tmp_path / "weights"), frames_at_once=30
    )


@pytest.fixture
def blurred() -> Pictures:
    """A grey square that moves to the right."""
    mattes = torch.zeros(6, 80, 96, dtype=torch.uint8)
    for index in range(6):
        mattes[index, 30:50, 20 + 4 * index : 40 + 4 * index] = 200
    return Pictures(mattes[..., None].expand(-1, -1, -1, 3).contiguous(), mattes)


def test_colours_and_mattes_change_near_the_person_alone(params, blurred):
    made, noted = params.deblur(blurred, "srgb", [slice(0, 6)])
    assert len(noted["weights"]) == 64
    assert not torch.equal(made.frames, blurred.frames)
    assert not torch.equal(made.mattes, blurred.mattes)
    near = torch.zeros_like(blurred.mattes, dtype=torch.bool)
    for index in range(6):
        left = 20 + 4 * index
        near[index, 30 - MARGIN : 50 + MARGIN, left - MARGIN : left + 20 + MARGIN] = True
    assert torch.equal(made.frames[~near], blurred.frames[~near])
    assert torch.equal(made.mattes[~near], blurred.mattes[~near])


def test_a_clip_learns_nothing_of_the_frames_of_another(params, blurred):
    clips = [slice(0, 4), slice(4, 6)]
    made, _ = params.deblur(blurred, "srgb", clips)
    other = dataclasses.replace(blurred, frames=blurred.frames.clone())
    other.frames[4:] = 255 - other.frames[4:]
    again, _ = params.deblur(other, "srgb", clips)
    assert torch.equal(again.frames[:4], made.frames[:4])
    whole, _ = params.deblur(other, "srgb", [slice(0, 6)])
    assert not torch.equal(whole.frames[:4], made.frames[:4])


def test_the_same_pictures_give_the_same_bytes(params, blurred):
    one, two = (params.deblur(blurred, "srgb", [slice(0, 6)])[0] for _ in range(2))
    assert torch.equal(one.frames, two.frames)
    assert torch.equal(one.mattes, two.mattes)


def test_a_frame_that_shows_nobody_stays_as_it_is(params, blurred):
    mattes = blurred.mattes.clone()
    mattes[2] = 0
    made, _ = params.deblur(dataclasses.replace(blurred, mattes=mattes), "srgb", [slice(0, 6)])
    assert torch.equal(made.frames[2], blurred.frames[2])
    nobody = dataclasses.replace(blurred, mattes=torch.zeros_like(mattes))
    made, _ = params.deblur(nobody, "srgb", [slice(0, 6)])
    assert torch.equal(made.frames, blurred.frames)


def test_a_long_clip_is_cut_and_its_last_piece_begins_earlier():
    assert pieces(5, 30) == [slice(0, 5)]
    assert pieces(6, 3) == [slice(0, 3), slice(3, 6)]
    assert pieces(7, 3) == [slice(0, 3), slice(3, 6), slice(4, 7)]


def test_weights_are_named_by_a_path_that_may_hold_a_variable(params, blurred, monkeypatch):
    monkeypatch.setenv("MY_WEIGHTS", params.weights)
    named = params.model_copy(update={"weights": "$(MY_WEIGHTS)"})
    assert torch.equal(
        named.deblur(blurred, "srgb", [slice(0, 6)])[0].frames,
        params.deblur(blurred, "srgb", [slice(0, 6)])[0].frames,
    )
    monkeypatch.delenv("MY_WEIGHTS")
    with pytest.raises(ConfigError, match="MY_WEIGHTS"):
        named.deblur(blurred, "srgb", [slice(0, 6)])
    nowhere = params.model_copy(update={"weights": "/nowhere"})
    with pytest.raises(ArtifactError, match=r"predeblur.deblurrer.weights: no weights"):
        nowhere.deblur(blurred, "srgb", [slice(0, 6)])
