"""One method in one failure mode: damaged, fitted and measured at every severity.

Whether that is good enough is not decided here: a rule may compare methods, so the stage
`stability_report` judges. What the pipeline refuses with its own errors and what falls over
otherwise are told apart.
"""

import logging
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.stress.fit import (
    FitSetup,
    Fitted,
    fit_method,
    lengthened,
)
from benchmarks.stress.input import prepare
from benchmarks.stress.measures import (
    Measured,
    mean_of_draws,
    measure,
    score_of,
)
from benchmarks.stress.params import ModeParams, SeverityParams
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.files import write_json
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.motion.clip import EstimatedShutter
from deblur_avatar.pipeline.check import check_scene
from deblur_avatar.pipeline.fusion import network_params
from deblur_avatar.pipeline.preprocess import Preprocessed
from deblur_avatar.training.params import RecipeParams

logger = logging.getLogger(__name__)

FIT_KEYS = ("budget", "seed", "draws", "networks", "blend", "instants", "no_oracle",
            "estimated_shutter", "shutter_weight", "exposure_gain", "start_noise",
            "degenerate")  # fmt: skip
PICTURES = ("blurred", "render", "truth")

LoadScene = Callable[[str], tuple[Clip, Reference]]


@dataclass(frozen=True)
class Item:
    """A method's rows in one mode, one a severity, and its worst picture if it drew any."""

    rows: dict[str, dict[str, Any]]
    worst: Measured | None

    def save(self, folder: Path) -> None:
        """Write `measured.json` and the pictures of the worst view."""
        write_json(folder / "measured.json", self.rows)
        if self.worst is not None:
            for name, picture in zip(PICTURES, self.worst.pictures, strict=True):
                write_picture(folder / f"{name}.png", picture)


def scenes_in(folder: Path) -> LoadScene:
    """Reads the scenes that `stability_scene` wrote."""
    return lambda name: (
        Clip.load(folder / name / "clip"),
        Reference.load(folder / name / "reference"),
    )


def run_mode(mode: ModeParams, setup: FitSetup, load_scene: LoadScene) -> Item:
    """Go through all severities of a mode.

    Args:
        mode: of the suite.
        setup: how one method is fitted.
        load_scene: gives the clip and the truth of a scene by name.

    Raises:
        ConfigError: if a severity asks for something that there is not.
    """
    rows: dict[str, dict[str, Any]] = {}
    worst: Measured | None = None
    for label, severity in mode.severities.items():
        _check_keys(label, severity)
        skipped = _does_not_apply(severity, setup)
        if skipped is not None:
            rows[label] = {"skipped": skipped}
            continue
        row, shown = _attempt(severity, setup, load_scene)
        rows[label] = {"scene": severity.scene, **row}
        logger.info("%s: %s", label, _shown(row))
        if shown is not None and (worst is None or shown.numbers["score"] < worst.numbers["score"]):
            worst = shown
    return Item(rows, worst)


def _does_not_apply(severity: SeverityParams, setup: FitSetup) -> str | None:
    """Why a severity would change nothing for a method, or is not asked of it."""
    known = type(setup.method.trajectory.motion).model_fields
    if "estimated_shutter" in severity.fit and "shutter" not in known:
        return "this method has no shutter to estimate"
    if "start_noise" in severity.fit and "start_noise" not in known:
        return "this method starts without noise"
    if "networks" in severity.fit and setup.networks is None:
        return "this method has an avatar without networks"
    if "blend" in severity.fit and network_params(setup.method.fusion) is None:
        return "this method has no fusion network"
    if "instants" in severity.fit and "virtual_poses" not in known:
        return "this method has one instant an exposure"
    return None


def _check_keys(label: str, severity: SeverityParams) -> None:
    unknown = sorted(set(severity.fit) - set(FIT_KEYS))
    if unknown:
        raise ConfigError(f"severity {label!r}: fit has no {unknown}, it has {', '.join(FIT_KEYS)}")


def _attempt(
    severity: SeverityParams, setup: FitSetup, load_scene: LoadScene
) -> tuple[dict[str, Any], Measured | None]:
    """One severity: what was measured, and its worst draw, or how it ended instead."""
    clip, reference = load_scene(severity.scene)
    row: dict[str, Any] = {
        "refused": None,
        "crashed": None,
        "flags": [],
        "chooses_virtual_poses": "pixels_per_pose"
        in type(setup.method.trajectory.motion).model_fields,
    }
    with _warnings() as messages:
        try:
            prepared = prepare(
                clip, capsule_body(), severity.damage, setup.schedule.image_height,
                setup.validation_stride, setup.seed,
            )  # fmt: skip
            row["flags"] = _flags(prepared.blurred, prepared.metrics)
            fits = list(_draws(prepared.blurred, severity, setup))
            measured = [measure(prepared.blurred, reference, f, setup.device) for f in fits]
            if setup.own_oracle and "no_oracle" not in severity.fit:
                row["oracle"] = _oracle(prepared, severity, setup, reference)
        except (ConfigError, ArtifactError) as error:
            return _ended(row, "refused", error, messages), None
        except Exception as error:  # a crash is what this suite looks for
            logger.warning("%s", "".join(traceback.format_exception(error)))
            return _ended(row, "crashed", error, messages), None
    once = list(dict.fromkeys(messages))  # each draw says the same again
    worst = min(measured, key=lambda one: one.numbers["score"])
    return {**row, **mean_of_draws([one.numbers for one in measured]), "warnings": once}, worst


def _ended(
    row: Mapping[str, Any], how: str, error: Exception, messages: list[str]
) -> dict[str, Any]:
    return {**row, how: f"{type(error).__name__}: {error}", "warnings": messages}


def _draws(seen: Observations, severity: SeverityParams, setup: FitSetup) -> Iterator[Fitted]:
    """As many fits to what is seen as a severity asks for."""
    chosen, recipe = _changed(setup, severity.fit)
    first, count = int(severity.fit.get("seed", 0)), int(severity.fit.get("draws", setup.draws))
    degenerate = severity.fit.get("degenerate", 0.0)
    for draw in range(first, first + count):
        yield fit_method(seen, chosen, recipe, draw=draw, degenerate=degenerate)


def _oracle(
    prepared: Preprocessed, severity: SeverityParams, setup: FitSetup, reference: Reference
) -> dict[str, Any]:
    """What the same method makes of the sharp frames and the same poses."""
    assert prepared.sharp is not None  # the studio knows all
    fits = _draws(prepared.sharp, severity, setup)
    seen, device = prepared.blurred, setup.device
    return mean_of_draws([score_of(seen, reference, fitted, device) for fitted in fits])


def _changed(setup: FitSetup, fit: Mapping[str, float]) -> tuple[FitSetup, RecipeParams]:
    """Method, schedule and recipe as a severity wants them."""
    method = setup.method
    recipe = setup.networks if "networks" in fit else setup.plain
    assert recipe is not None  # or the severity was skipped
    changes: dict[str, Any] = {}
    if "exposure_gain" in fit:
        recipe = recipe.model_copy(update={"exposure_gain": "frame"})
    motion = method.trajectory.motion
    if "estimated_shutter" in fit:
        changes["shutter"] = EstimatedShutter(
            kind="estimated", rate=fit["estimated_shutter"], weight=fit["shutter_weight"]
        )
    if "start_noise" in fit:
        changes["start_noise"] = fit["start_noise"]
    motion = motion.model_copy(update=changes)
    trajectory = method.trajectory.model_copy(update={"motion": motion})
    changed = replace(
        setup,
        method=method.model_copy(update={"trajectory": trajectory}),
        schedule=lengthened(setup.schedule, fit.get("budget", 1.0)),
    )
    return changed, recipe


def _flags(observations: Observations, metrics: Mapping[str, Any]) -> list[str]:
    """What the scene's check complains of."""
    findings = check_scene(observations, metrics)["findings"]
    return [name for name, finding in findings.items() if finding["verdict"] in ("warn", "fail")]


@contextmanager
def _warnings() -> Iterator[list[str]]:
    """What the package warns of meanwhile."""
    messages: list[str] = []

    class LogCapture(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    capture, package = LogCapture(logging.WARNING), logging.getLogger("deblur_avatar")
    package.addHandler(capture)
    try:
        yield messages
    finally:
        package.removeHandler(capture)


def _shown(row: Mapping[str, Any]) -> str:
    if row["refused"] or row["crashed"]:
        return str(row["refused"] or row["crashed"])
    return f"{row['score']:.2f} dB in {row['seconds']:.1f} s"
