import pytest
import torch

from deblur_avatar.config.reading import parse
from deblur_avatar.config.section import Params
from deblur_avatar.imaging.deblurring.deblurrer import Pictures
from deblur_avatar.imaging.deblurring.kinds import DEBLURRERS
from deblur_avatar.pipeline.score_dstnet import ScoreDstnetParams, score_deblurrers
from tests.deblurring_clips import striped_clips


class Knows(Params):
    """Gives the sharp clips themselves."""

    kind: str

    def deblur(self, blurred, averaging_space, clips):
        truth = striped_clips()
        for sharp, matte, kept in zip(
            truth.sharp, truth.sharp_mattes, truth.blurred_mattes, strict=True
        ):
            if any(torch.equal(window, blurred.mattes) for window in kept):
                return Pictures(sharp, matte), {}
        raise AssertionError("no such clip")


@pytest.fixture
def scored(monkeypatch):
    monkeypatch.setitem(DEBLURRERS, "knows", Knows)
    section = {"deblurrers": {"truth": {"kind": "knows"}}, "shown_window": 7}
    return score_deblurrers(striped_clips(), parse(ScoreDstnetParams, section, "score_dstnet"))


def test_each_window_is_scored_by_itself_and_longer_ones_are_worse(scored):
    assert set(scored.scores) == {"3", "7"}
    short, long = (scored.scores[window]["blurred"] for window in ("3", "7"))
    for key in ("psnr", "psnr_person", "psnr_matte"):
        assert long[key] < short[key] < scored.scores["3"]["truth"][key]
    assert short["psnr_person"] < short["psnr"]


def test_the_strip_has_a_row_a_person_with_the_truth_at_its_end(scored):
    clips = striped_clips()
    assert scored.strip.shape == (2 * 32, 3 * 32, 3)
    middle = clips.sharp.shape[1] // 2
    assert torch.equal(scored.strip[32:, 64:], clips.sharp[1, middle])
    assert torch.equal(scored.strip[:32, :32], clips.blurred[0, 1, middle])
