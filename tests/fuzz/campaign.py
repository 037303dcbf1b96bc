"""All hostile inputs of one reader, and what became of them."""

import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from tests.fuzz.guarded import Tally, Tell, in_child, noted_functions, try_input
from tests.fuzz.mutations import hostile
from tests.fuzz.odd_places import ODD, SOUND_LINK, clear
from tests.fuzz.readers import Reader
from tests.fuzz.recipes import recipes

LONGEST_S = 300.0  # for one input
MAX_DEATHS = 40  # of one reader's process; then its campaign is over


def campaign(
    reader: Reader, inputs: int, number: int, kept: Path | None = None, every: int = 1
) -> Tally:
    """Try odd places, recipes and `inputs` drawn files on one reader, in a process of its own.

    A process that ends is followed by another, which goes on after the input that ended it.

    Args:
        reader: which.
        inputs: how many are drawn.
        number: seed of the draws.
        kept: folder for the inputs that failed.
        every: which of the recipes are tried: all, or every second, or ...
    """
    tally = Tally(reader.name)
    while not tally.finished and tally.deaths < MAX_DEATHS:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
            run = _Run(reader, Path(folder), tally, kept)
            tally = in_child(
                lambda tell, run=run: run.all(inputs, number, every, tell), tally, LONGEST_S
            )
        if not tally.finished:
            if kept is not None:
                shutil.copy(kept / "last", kept / _name(reader, f"input {tally.inputs}", "last"))
            tally.inputs += 1
    tally.reader = reader.name
    return tally


def _name(reader: Reader, failure: str, file: str) -> str:
    return f"{reader.name}-{failure}-{file}".replace("/", "_")[:150]


class _Run:
    """One process' part of a campaign, after the inputs that the tally knows of."""

    def __init__(self, reader: Reader, folder: Path, tally: Tally, kept: Path | None) -> None:
        self._reader, self._tally, self._kept = reader, tally, kept
        self._good = folder / "good"
        self._count, self._acts = 0, list[str]()
        self._tell: Tell = lambda tally: None

    def all(self, inputs: int, number: int, every: int, tell: Tell) -> Tally:
        """Everything, in an order that is always the same."""
        logging.disable()
        self._tell = tell
        self._good.mkdir()
        self._reader.write(self._good)
        files = {
            path: path.read_bytes() for path in sorted(self._good.rglob("*")) if path.is_file()
        }
        os.chdir(self._good)
        self._undamaged()
        for path in _one_of_each_kind(files):
            for name, put in ODD.items():
                self._odd(name, put, path, files[path])
            for content in islice(recipes(path.suffix, files[path]), 0, None, every):
                self._content(path, content, files[path])

        @seed(number)
        @settings(
            max_examples=max(inputs, 1),
            database=None,
            deadline=None,
            phases=(Phase.generate,),
            suppress_health_check=list(HealthCheck),
        )
        @given(st.data())
        def drawn(data: st.DataObject) -> None:
            path = data.draw(st.sampled_from(list(files)))
            self._content(path, data.draw(hostile(files[path], path.suffix)), files[path])

        if inputs:
            drawn()
        return self._tally

    def _undamaged(self) -> None:
        before = self._tally.read
        if self._attempt() and self._tally.read == before:
            self._tally.failures["good"] = "the undamaged file was refused"
        if not self._tally.functions:
            with noted_functions(self._tally.functions):
                self._reader.read(self._good)

    def _odd(
        self, name: str, put: Callable[[Path, bytes], object], path: Path, good: bytes
    ) -> None:
        before = self._tally.read
        clear(path)
        put(path, good)
        self._note(name.encode())
        if self._attempt() and name == SOUND_LINK and self._tally.read == before:
            self._tally.failures["link"] = f"{path.name} was refused as a link"
        clear(path)
        path.write_bytes(good)

    def _content(self, path: Path, content: bytes, good: bytes) -> None:
        known = set(self._tally.failures)
        path.write_bytes(content)
        self._note(content)
        self._attempt()
        path.write_bytes(good)
        for failure in set(self._tally.failures) - known:
            if self._kept is not None:
                (self._kept / _name(self._reader, failure, path.name)).write_bytes(content)

    def _note(self, content: bytes) -> None:
        if self._kept is not None and self._count >= self._tally.inputs:
            (self._kept / "last").write_bytes(content)  # should it end the process

    def _attempt(self) -> bool:
        """Try what is there; False for what an earlier process has tried."""
        self._count += 1
        if self._count <= self._tally.inputs:
            return False
        self._tell(self._tally)
        try_input(lambda: self._reader.read(self._good), self._tally, self._acts)
        return True


def _one_of_each_kind(files: dict[Path, bytes]) -> Iterator[Path]:
    """The first file of each folder and ending: the others are read in the same way."""
    seen = set()
    for path in files:
        if (path.parent, path.suffix) not in seen:
            seen.add((path.parent, path.suffix))
            yield path
