import json

import pytest

from deblur_avatar.imaging.dstnet_weights import DstnetWeights
from deblur_avatar.pipeline.dstnet import train
from deblur_avatar.training import resume
from deblur_avatar.training.deblurring import DeblurringTrainer
from tests.deblurring_clips import TRAINING, striped_clips

SHORT = TRAINING.model_copy(update={"iterations": 12})


class Stopped(Exception):
    pass


def trained(work, stop_after: int | None = None, seed: int = 0) -> tuple[DstnetWeights, list[int]]:
    """Train in a working folder; raise `Stopped` when so many steps were reported."""
    seen: list[int] = []

    def report(step: int, losses: object) -> None:
        seen.append(step)

    steps = DeblurringTrainer.step
    count = 0

    def step(self: DeblurringTrainer) -> float:
        nonlocal count
        if count == stop_after:
            raise Stopped
        count += 1
        return steps(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DeblurringTrainer, "step", step)
        with resume.run_folder(work, "key", frozenset()) as folder:
            made = train(
                striped_clips(), SHORT, seed, origin="of stripes", report=report, folder=folder
            )
            folder.finish(work)
    return made, [count, *seen]


@pytest.fixture(autouse=True)
def kept_at_every_step(monkeypatch):
    monkeypatch.setattr(resume, "SAVE_EVERY_S", 0.0)


def test_a_training_that_was_stopped_ends_with_the_same_bytes(tmp_path):
    whole, _ = trained(tmp_path / "whole")
    with pytest.raises(Stopped):
        trained(tmp_path / "stopped", stop_after=5)
    later, (steps, *_) = trained(tmp_path / "stopped")
    assert steps == SHORT.iterations - 5
    whole.save(tmp_path / "a")
    later.save(tmp_path / "b")
    for name in ("manifest.json", "tensors.safetensors"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_weights_say_what_made_them(tmp_path):
    made, _ = trained(tmp_path / "work", seed=9)
    assert json.loads(made.recipe) == {"seed": 9, **SHORT.model_dump()}
    assert made.clips == "of stripes"
    assert made.sizes == SHORT.network


def test_a_training_reports_its_loss(tmp_path, monkeypatch):
    monkeypatch.setattr("deblur_avatar.pipeline.dstnet.SHOWN", 4)
    _, (_, *seen) = trained(tmp_path / "work")
    assert seen == [4, 8, 12]
