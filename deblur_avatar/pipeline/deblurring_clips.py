"""Training data of `dstnet_small`: clips of persons and motions that are in no scene.

Persons to train on and persons to score on have seeds of different names.
"""

from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.config.section import Count, Params
from deblur_avatar.sources.studio.deblurring_takes import TakesParams, film_takes


class DeblurringClipsParams(Params):
    """How many clips there are, and what they are like."""

    training: Count
    validation: Count
    takes: TakesParams


def make_clips(
    params: DeblurringClipsParams, body: Body, seed: int
) -> tuple[DeblurringClips, DeblurringClips]:
    """Film the clips to train on, and those to score on.

    Args:
        params: of the clips.
        body: whose joints all persons have.
        seed: that every clip's own is derived from, by its number.
    """
    counts = {"training": params.training, "validation": params.validation}
    seeds = {
        part: [run.derive_seed(seed, part, str(index)) for index in range(count)]
        for part, count in counts.items()
    }
    training, validation = (film_takes(params.takes, body, own) for own in seeds.values())
    return training, validation
