"""What a fitting stage leaves on disk while it runs: where it can go on, and how far it had come.

A stage that writes to `data/<stage>/<item>` works in `data/<stage>/.<item>.unfinished`, which DVC
leaves alone. A stage that was stopped there, however it was stopped, goes on from the last
`Progress` and ends, on the CPU, with the same bytes as one that never stopped; what was left by
other code, parameters or inputs is thrown away. The folder is gone once the stage is done.
"""

import fcntl
import hashlib
import logging
import os
import re
import shutil
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.storage import Artifact
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.files import read_json, write_json
from deblur_avatar.imaging.lpips import HEADS_VARIABLE, WEIGHTS_VARIABLE
from deblur_avatar.readers.file_contents import add_contents

logger = logging.getLogger(__name__)

PACKAGE = Path(__file__).resolve().parents[1]
CODE = (".py", ".cpp", ".h")
SAVE_EVERY_S = 20.0  # a save takes some 20 ms: a thousandth of the time; changes no result


@dataclass(frozen=True, kw_only=True)
class Progress(Artifact):
    """Everything that one more iteration needs; `key` says of which code, parameters and inputs."""

    schema: ClassVar[str] = "progress/1"

    key: str
    iteration: int
    seconds: float
    left_out: int
    tensors: dict[str, Tensor]


@dataclass(frozen=True, kw_only=True)
class Snapshot(Artifact):
    """An avatar and its motion on the way."""

    schema: ClassVar[str] = "snapshot/1"

    avatar: Avatar
    motion: Motion


class RunFolder:
    """One stage's folder while it runs; `snapshots` are the iterations after which one is kept."""

    def __init__(self, path: Path, key: str, snapshots: frozenset[int]) -> None:
        self._path, self._key, self._wanted = path, key, snapshots
        self._saved = time.monotonic()
        self.progress = self._newest()

    def due(self) -> bool:
        """Whether it is time to save."""
        return time.monotonic() - self._saved >= SAVE_EVERY_S

    def save(
        self, iteration: int, seconds: float, left_out: int, tensors: dict[str, Tensor]
    ) -> None:
        """Keep the state after an iteration; the one before goes once this one is whole.

        Raises:
            ArtifactError: if the disk refuses; what was kept before stays.
        """
        progress = Progress(
            key=self._key, iteration=iteration, seconds=seconds, left_out=left_out, tensors=tensors
        )
        progress.save(self._place(iteration))
        for older in self._kept():
            if older != iteration:
                shutil.rmtree(self._place(older), ignore_errors=True)
        self._saved = time.monotonic()

    def wants(self, iteration: int) -> bool:
        """Whether a snapshot is to be kept after this iteration."""
        return iteration in self._wanted

    def keep(self, iteration: int, seconds: float, snapshot: Snapshot) -> None:
        """Keep a snapshot and when in training it was taken."""
        snapshot.save(_snapshot(self._path, iteration))
        write_json(self._path / f"snapshot_{iteration:06d}.json", {"seconds": seconds})

    def finish(self, out: Path) -> list[dict[str, int | float]]:
        """Hand the snapshots to `out` and throw the rest away.

        Returns:
            `iteration` and `seconds` of training of each snapshot, in order.

        Raises:
            ArtifactError: if one of them is damaged.
        """
        taken = taken_snapshots(self._path, self._wanted)
        for iteration in self._kept():  # who is stopped from here on begins anew
            shutil.rmtree(self._place(iteration), ignore_errors=True)
        if taken:
            shutil.rmtree(out / "snapshots", ignore_errors=True)
            shutil.move(self._path / "snapshots", out / "snapshots")
        shutil.rmtree(self._path)
        return taken

    def _newest(self) -> Progress | None:
        for iteration in reversed(self._kept()):
            try:
                progress = Progress.load(self._place(iteration))
            except ArtifactError as error:
                logger.warning("what was kept after iteration %d is damaged: %s", iteration, error)
                continue
            if progress.key == self._key:
                logger.info("going on after iteration %d", iteration)
                return progress
            logger.info("another run's state is thrown away: code, parameters or inputs changed")
        shutil.rmtree(self._path)
        self._path.mkdir()
        return None

    def _kept(self) -> list[int]:
        names = (re.fullmatch(r"after_([0-9]+)", path.name) for path in self._path.iterdir())
        return sorted(int(name[1]) for name in names if name)

    def _place(self, iteration: int) -> Path:
        return self._path / f"after_{iteration:06d}"


def taken_snapshots(folder: Path, wanted: Iterable[int]) -> list[dict[str, int | float]]:
    """Which of the wanted snapshots a run has kept, and after how many seconds, in order.

    Raises:
        ArtifactError: if what was kept is damaged.
    """
    taken: list[dict[str, int | float]] = []
    for iteration in sorted(wanted):
        path = folder / f"snapshot_{iteration:06d}.json"
        if path.exists():
            try:
                seconds = read_json(path).get("seconds")
            except ArtifactError:
                seconds = None
            if not isinstance(seconds, int | float) or not _snapshot(folder, iteration).is_dir():
                raise ArtifactError(f"{path} is damaged; delete {folder}, then run the stage again")
            taken.append({"iteration": iteration, "seconds": seconds})
    return taken


def _snapshot(folder: Path, iteration: int) -> Path:
    return folder / "snapshots" / f"{iteration:06d}"


@contextmanager
def run_folder(out: Path, key: str, snapshots: frozenset[int]) -> Iterator[RunFolder]:
    """The folder of the run that writes to `out`, which no second process may write at once.

    Raises:
        ArtifactError: if there is no writing there.
        ConfigError: if another process is at it.
    """
    path = out.parent / f".{out.name}.unfinished"
    lock = out.parent / f".{out.name}.lock"
    try:
        path.mkdir(parents=True, exist_ok=True)
        held = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise ArtifactError(f"cannot write beside {out}: {error.strerror}") from error
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"another process is writing {out}; wait for it, or stop it first"
            ) from None
        yield RunFolder(path, key, snapshots)
        lock.unlink(missing_ok=True)
    finally:
        os.close(held)


def run_key(facts: Sequence[object], settings: Iterable[Any], inputs: Iterable[Path]) -> str:
    """A digest of all that decides a stage's result: facts, parameters, inputs and this code.

    Args:
        facts: a seed, a device and what else is neither parameter nor input; each must say in words
            all that it is. Which weights of LPIPS the environment names is among it without them.
        settings: parameters.
        inputs: folders; one that is not there is refused later, by who reads it.
    """
    weights = [os.environ.get(variable) for variable in (WEIGHTS_VARIABLE, HEADS_VARIABLE)]
    digest = hashlib.sha256(f"{[*facts]} {torch.__version__} {weights}".encode())
    for setting in settings:
        digest.update(setting.model_dump_json().encode())
    add_contents(digest, PACKAGE, CODE)
    for folder in inputs:
        if folder.exists():
            add_contents(digest, folder)
    return digest.hexdigest()
