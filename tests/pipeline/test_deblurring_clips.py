import torch

from deblur_avatar.pipeline.deblurring_clips import DeblurringClipsParams, make_clips
from tests.sources.studio.test_deblurring_takes import PARAMS

TWO = DeblurringClipsParams(
    training=1, validation=1, takes=PARAMS.model_copy(update={"frames": 2, "windows": (1,)})
)


def test_persons_to_train_on_and_to_score_on_are_others_and_more_of_them_change_none(body):
    training, validation = make_clips(TWO, body, 0)
    assert not torch.equal(training.sharp, validation.sharp)
    more, same = make_clips(TWO.model_copy(update={"training": 2}), body, 0)
    assert torch.equal(more.sharp[:1], training.sharp)
    assert torch.equal(same.sharp, validation.sharp)
    other, _ = make_clips(TWO, body, 1)
    assert not torch.equal(other.sharp, training.sharp)
