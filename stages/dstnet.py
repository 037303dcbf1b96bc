"""Train the deblurring network; goes on where it was stopped."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.dstnet import train
from deblur_avatar.readers.file_contents import contents_digest
from deblur_avatar.training.deblurring import DstnetTrainingParams
from deblur_avatar.training.resume import run_folder, run_key


def main(clips: Path, work: Path, out: Path, params_file: Path) -> None:
    """Write the weights; `work` holds what a stopped training goes on from."""
    params = load_params(params_file, "dstnet", DstnetTrainingParams)
    seed = load_params(params_file, "seed", int)

    with run.stage("dstnet", out.name, seed) as context:
        report = run.fitting_progress("dstnet", params.iterations)
        key = run_key([context.seed], [params], [clips])
        with run_folder(work, key, frozenset()) as folder:
            weights = train(
                DeblurringClips.load(clips), params, context.seed, origin=contents_digest(clips),
                report=report, folder=folder,
            )  # fmt: skip
            weights.save(out)
            folder.finish(work)


if __name__ == "__main__":
    run.command(main)
