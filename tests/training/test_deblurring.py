import math

import pytest
import torch

from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.training.deblurring import (
    DeblurringTrainer,
    DstnetTrainingParams,
    Layers,
    deblurring_loss,
    draw_batch,
    rate_at,
)
from tests.deblurring_clips import TRAINING, striped_clips


@pytest.fixture(scope="module")
def layers() -> Layers:
    return Layers.of(striped_clips())


def test_a_batch_is_the_same_for_the_same_seed_and_step_alone(layers):
    one, again = draw_batch(layers, TRAINING, 3, 7), draw_batch(layers, TRAINING, 3, 7)
    assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
    for seed, step in ((3, 8), (4, 7)):
        assert not torch.equal(draw_batch(layers, TRAINING, seed, step)[0], one[0])


def test_blurred_and_sharp_pieces_are_of_the_same_place_and_time(layers):
    """Windows of one instant are as sharp as the sharp ones, however pieces are turned."""
    same = Layers(layers.sharp, layers.sharp[:, None])
    for step in range(12):
        blurred, sharp = draw_batch(same, TRAINING, 0, step)
        assert torch.equal(blurred, sharp)
    assert blurred.shape == (TRAINING.batch, TRAINING.frames, 4, TRAINING.size, TRAINING.size)
    assert 0 <= float(blurred.min()) < float(blurred.max()) <= 1


def test_pieces_are_turned_over_and_their_colours_exchanged(layers):
    seen = {tuple(draw_batch(layers, TRAINING, 0, s)[0][0].flatten().tolist()) for s in range(8)}
    assert len(seen) == 8
    red = torch.zeros_like(layers.sharp)
    red[:, :, [0, 3]] = 255
    dyed = Layers(red, red[:, None])
    brightest = {
        int(draw_batch(dyed, TRAINING, 0, step)[0][0, 0, :3].mean((1, 2)).argmax())
        for step in range(16)
    }
    assert brightest == {0, 1, 2}


def test_the_rate_rises_then_falls_to_its_end():
    rates = [rate_at(step, TRAINING) for step in range(TRAINING.iterations)]
    assert rates[0] == TRAINING.rate / TRAINING.rise
    assert max(rates) == rates[TRAINING.rise] == TRAINING.rate
    assert rates[-1] == pytest.approx(TRAINING.final_rate)
    assert rates[TRAINING.rise :] == sorted(rates[TRAINING.rise :], reverse=True)


def test_the_loss_is_charbonnier_s_and_a_share_of_fourier_s():
    zero, one = torch.zeros(1, 1, 4, 2, 2), torch.ones(1, 1, 4, 2, 2)
    assert float(deblurring_loss(zero, zero, 0.1)) == pytest.approx(1e-6)
    assert float(deblurring_loss(one, zero, 0.0)) == pytest.approx(1.0)
    # Of an even difference only the coefficient of frequency 0 is left: 4 of 4 x 2 numbers.
    assert float(deblurring_loss(one, zero, 0.5)) == pytest.approx(1.0 + 0.5 * 4 / 8)


def test_a_batch_that_is_shown_again_and_again_is_learned(layers, monkeypatch):
    batch = draw_batch(layers, TRAINING, 1, 0)
    monkeypatch.setattr("deblur_avatar.training.deblurring.draw_batch", lambda *_: batch)
    trainer = DeblurringTrainer(TRAINING, layers, 0)
    losses = [trainer.step() for _ in range(TRAINING.iterations)]
    assert losses[-1] < 0.95 * losses[0]


def test_a_training_that_goes_on_is_the_one_that_never_stopped_to_the_last_bit(layers):
    whole = DeblurringTrainer(TRAINING, layers, 0)
    for _ in range(5):
        whole.step()
    kept = {name: value.clone() for name, value in whole.state().items()}
    later = DeblurringTrainer(TRAINING, layers, 0)
    later.go_on(5, kept)
    for _ in range(3):
        assert whole.step() == later.step()
    assert whole.state().keys() == later.state().keys()
    assert all(torch.equal(value, later.state()[name]) for name, value in whole.state().items())


def test_the_same_seed_trains_the_same_network(layers):
    one, again, other = (DeblurringTrainer(TRAINING, layers, seed) for seed in (0, 0, 1))
    losses = [[trainer.step() for _ in range(2)] for trainer in (one, again, other)]
    assert losses[0] == losses[1] != losses[2]
    assert all(torch.equal(v, again.state()[n]) for n, v in one.state().items())


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [({"size": 24}, "multiple of 16"), ({"rise": 40}, "rise"), ({"rate": math.inf}, "rate")],
)
def test_a_training_that_cannot_be_is_refused(changes, complaint):
    with pytest.raises(ConfigError, match=complaint):
        parse(DstnetTrainingParams, TRAINING.model_dump() | changes, "dstnet")
