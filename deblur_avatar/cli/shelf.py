"""Shelf: the runs of one scene as a viewer offers them, fitted or still being fitted."""

from collections.abc import Sequence
from pathlib import Path

import torch

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.cli.homes import PARAMS
from deblur_avatar.cli.run_on_disk import Kept, RunOnDisk
from deblur_avatar.config.reading import load_params
from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.reblur import mean_reblur_psnr
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.shown_motion import ShownMotion, shown_motions
from deblur_avatar.geometry.spacing import evenly_spaced

SECONDS, FPS = 10.0, 30.0  # of motions that were not filmed
FRAMES = 3  # that a point of the curve is a mean over


class SceneRuns:
    """All runs of a scene that have an avatar; the one asked for stands first.

    Args:
        folder: whose parameters name the runs.
        name: of the one asked for.
        motions: names, as `shown_motions` takes them.

    Raises:
        ConfigError: if there is no such run.
        ArtifactError: if it has no avatar yet, not even one on its way.
    """

    def __init__(self, folder: Path, name: str, motions: Sequence[str]) -> None:
        wanted = RunOnDisk(folder, name)
        if wanted.newest() is None:
            raise ArtifactError(
                f"no avatar/1 in data/fusion/{name}, no snapshot on the way to one: fit it first"
            )
        runs = load_params(folder / PARAMS, "runs", dict[str, RunParams])
        names = [other for other, run in runs.items() if run.scene == wanted.run.scene]
        same = (RunOnDisk(folder, other) for other in names if other != name)
        self._runs = {name: wanted} | {one.name: one for one in same if one.newest() is not None}
        self.names = tuple(self._runs)
        self._motions = tuple(motions)
        self._last: tuple[str, Kept] | None = None
        self._seen: dict[str, Observations] = {}  # by run
        self._points: dict[str, dict[int, float]] = {name: {} for name in self.names}

    def news(self, name: str) -> FittedRun | None:
        """A run's avatar, if it is not what was asked for last.

        Raises:
            ArtifactError: if it is damaged, or was thrown away in between.
        """
        kept = self._runs[name].newest()
        if kept is None or self._last == (name, kept):
            return None
        run = self._runs[name].fitted(kept, self._observations(name))
        self._last = (name, kept)
        return run

    def motions(self, run: FittedRun) -> list[ShownMotion]:
        """What it can be shown in."""
        return shown_motions(run, self._motions, FPS, SECONDS)

    def status(self, name: str) -> str:
        """How far fitting is, in a sentence."""
        standing, left = self._runs[name].standing(), self._runs[name].seconds_left()
        if standing.finished:
            return f"Fitted: {standing.last} steps."
        whole = ", of another schedule" if standing.last is None else f" of {standing.last}"
        text = f"Step {standing.iteration}{whole}"
        text += "." if left is None else f", about {left:.0f} s of fitting left."
        kept = self._runs[name].newest()
        if kept is None or kept.iteration == standing.iteration:
            return text
        return f"{text} Shown: step {kept.iteration}."

    def fitting(self, name: str) -> bool:
        """Whether more steps of a run are to come, now or once somebody goes on with it."""
        return not self._runs[name].standing().finished

    def curve(self, name: str) -> list[tuple[int, float]]:
        """Steps of fitting, and how well the avatar of then explains blurred frames, dB.

        Frames set aside for validation, where there are any. Each call scores one avatar more.

        Raises:
            ArtifactError: if an avatar is damaged, or was thrown away in between.
        """
        points, run = self._points[name], self._runs[name]
        new = [kept for kept in run.all_kept() if kept.iteration not in points]
        if new:
            points[new[0].iteration] = self._explained(run.fitted(new[0], self._observations(name)))
        return sorted(points.items())

    def _observations(self, name: str) -> Observations:
        if name not in self._seen:
            self._seen[name] = self._runs[name].observations()
        return self._seen[name]

    @staticmethod
    def _explained(run: FittedRun) -> float:
        seen = run.observations
        model = avatar_from_artifact(run.avatar, seen.body, torch.device("cpu"))
        frames = evenly_spaced(seen.validation or seen.train, FRAMES)
        with torch.no_grad():
            score = mean_reblur_psnr(model, seen, run.motion, frames)
        assert score is not None
        return score
