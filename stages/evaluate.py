"""Stage `evaluate`: novel views and poses against the sharp truth, motion against true motion."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.evaluate import evaluate
from deblur_avatar.reporting.evaluation_pictures import draw_pictures


def main(
    scene: str, method: str, observations: Path, reference: Path, fusion: Path, out: Path,
    metrics: Path, cost: Path, params_file: Path,
) -> None:  # fmt: skip
    """Measure one method on one scene; how fast it renders is written to `cost`."""
    schedule = load_params(params_file, "schedule", str)
    seed = load_params(params_file, "seed", int)
    with run.stage("evaluate", f"{scene}-{method}", seed) as context:
        seen, avatar = Observations.load(observations), Avatar.load(fusion / "avatar")
        motion = Motion.load(fusion / "motion")
        evaluation = evaluate(seen, Reference.load(reference), avatar, motion, context.device)
        pictures = draw_pictures(evaluation.comparisons, seen, avatar, motion, context.device)
        pictures.save(out)
        content = {"scene": scene, "method": method, **evaluation.metrics, "run": {
            "seed": seed, "device": context.device.type, "schedule": schedule,
            "iterations": avatar.iteration, **evaluation.computed,
        }}  # fmt: skip
        write_json(out / "views.json", pictures.index)
        write_json(metrics, content)
        write_json(cost, {"render_fps": evaluation.render_fps})


if __name__ == "__main__":
    run.command(main)
