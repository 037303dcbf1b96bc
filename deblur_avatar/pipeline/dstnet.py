"""Training of `dstnet_small`, the deblurring network of our own size.

A training that was stopped goes on from what it kept (training/resume.py) and ends with the same
bytes.
"""

import json
import time
from collections.abc import Callable, Mapping

from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.imaging.dstnet_weights import DstnetWeights
from deblur_avatar.training.deblurring import DeblurringTrainer, DstnetTrainingParams, Layers
from deblur_avatar.training.resume import RunFolder

SHOWN = 20  # steps whose mean loss is reported


def train(
    clips: DeblurringClips,
    params: DstnetTrainingParams,
    seed: int,
    *,
    origin: str,
    report: Callable[[int, Mapping[str, float]], None],
    folder: RunFolder,
) -> DstnetWeights:
    """Train a network from the beginning, or from where it was stopped.

    Args:
        clips: to train on.
        params: of network and training.
        seed: of all that is drawn.
        origin: what the weights say they were trained on, a digest of the clips.
        report: called with the iteration and the mean loss.
        folder: where it may go on from, and keeps its state.
    """
    trainer = DeblurringTrainer(params, Layers.of(clips), seed)
    seconds = 0.0
    if folder.progress is not None:
        kept = folder.progress
        trainer.go_on(kept.iteration, kept.tensors)
        seconds = kept.seconds
    begun, total = time.perf_counter() - seconds, 0.0
    while trainer.done < params.iterations:
        total += trainer.step()
        if trainer.done % SHOWN == 0:
            report(trainer.done, {"loss": total / SHOWN})
            total = 0.0
        if folder.due():
            folder.save(trainer.done, time.perf_counter() - begun, 0, trainer.state())
    return DstnetWeights(
        **params.network.model_dump(),
        recipe=json.dumps({"seed": seed, **params.model_dump()}, sort_keys=True),
        clips=origin,
        tensors={name: value.clone() for name, value in trainer.network.state_dict().items()},
    )
