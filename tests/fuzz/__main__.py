"""Hostile files for every reader: `make fuzz`; `make test` has a sample.

A reader gets odd places, the crashers that were kept (`recipes`), and files that hypothesis draws.
It reads the file, with finite numbers, or refuses it with an error of our own; it runs nothing, and
takes no more than so much memory and time. Prints JSON, a row a reader; ends with 1 on a failure.
"""

import argparse
import json
import logging
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

# Before anything of the package is imported: readers must do without checks of shapes.
os.environ["DEBLUR_AVATAR_CHECK_SHAPES"] = "0"

import numpy as np
import torch
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.readers import foreign_arrays, unpickling
from tests.fuzz.mutations import hostile
from tests.fuzz.odd_places import ODD, SOUND_LINK, clear
from tests.fuzz.readers import READERS, Reader
from tests.fuzz.recipes import recipes

MAX_ADDRESSES = 6 << 30  # bytes of address space: libraries reserve more than they use
MAX_SECONDS = 30  # by the clock for one input; other programs run as well
FORBIDDEN = (
    "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.forkpty", "os.spawn", "socket.connect",
    "socket.bind", "os.remove", "os.rename", "os.rmdir", "os.chmod", "os.link", "os.symlink",
    "shutil.rmtree",
)  # fmt: skip


class TooSlow(BaseException):
    """Not an `Exception`, so that no reader takes it for damage of its file."""


class Attack:
    """All inputs of one reader, and what became of them."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self.reader, self.folder = reader, folder
        self.read = self.refused = 0
        self.failures: dict[str, str] = {}
        self.acts: list[str] | None = None
        sys.addaudithook(self._note)
        reader.write(folder)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        self.files = {path: path.read_bytes() for path in paths}

    def run(self, inputs: int, every: int) -> dict[str, Any]:
        """Try everything, in an order that is always the same."""
        os.chdir(self.folder)
        self.attempt("the undamaged file", wanted=True)
        for path in {(path.parent, path.suffix): path for path in self.files}.values():
            good = self.files[path]
            for name, put in ODD.items():
                clear(path)
                put(path, good)
                self.attempt(f"{path.name}: {name}", wanted=name == SOUND_LINK)
                clear(path)
                path.write_bytes(good)
            for number, content in islice(enumerate(recipes(path.suffix, good)), 0, None, every):
                self.with_content(path, content, f"recipe {number}")
        if inputs:
            self.draw(inputs)
        return {
            "reader": self.reader.name, "read": self.read, "refused": self.refused,
            "failures": self.failures,
        }  # fmt: skip

    def draw(self, inputs: int) -> None:
        """Files that hypothesis makes of the good ones."""

        @seed(0)
        @settings(
            max_examples=inputs, database=None, deadline=None, phases=(Phase.generate,),
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        @given(st.data())
        def drawn(data: st.DataObject) -> None:
            path = data.draw(st.sampled_from(list(self.files)))
            content = data.draw(hostile(self.files[path], path.suffix))
            self.with_content(path, content, f"drawn {content[:60]!r}")

        drawn()

    def with_content(self, path: Path, content: bytes, label: str) -> None:
        """Try one file's content, and put the good one back."""
        path.write_bytes(content)
        self.attempt(f"{path.name}: {label}")
        path.write_bytes(self.files[path])

    def attempt(self, label: str, wanted: bool = False) -> None:
        """Read what is there."""
        problem = None
        self.acts = []
        signal.alarm(MAX_SECONDS)
        try:
            result = self.reader.read(self.folder)
            self.read += 1
            problem = "a value that is not finite" if _not_finite(result) else None
        except (ConfigError, ArtifactError) as error:
            self.refused += 1
            problem = f"refused: {error}" if wanted else None
        except (Exception, TooSlow) as error:
            places = traceback.extract_tb(error.__traceback__)
            problem = f"{type(error).__name__}: {error!s:.200} at {places[-1]}"
        finally:
            signal.alarm(0)
            acts, self.acts = self.acts, None
        if problem or acts:
            self.failures[label] = problem or f"was done while reading: {acts}"

    def _note(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.acts is None:
            return
        if event == "subprocess.Popen" and unpickling.__file__ in arguments[1]:
            return  # the guard of pickles
        mode = str(arguments[1] or "r")[:1] if event == "open" else "r"
        writes = mode in "wax" and not isinstance(arguments[0], int)  # a number is a pipe's
        if writes or event in FORBIDDEN or event == "subprocess.Popen":
            self.acts.append(f"{event} {arguments!r:.100}")


def _not_finite(value: object) -> bool:
    if isinstance(value, float):
        return not np.isfinite(value)
    if isinstance(value, torch.Tensor):
        return value.is_floating_point() and not bool(value.isfinite().all())
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fc" and not bool(np.isfinite(value).all())
    if isinstance(value, dict):
        return any(map(_not_finite, value.values()))
    if isinstance(value, list | tuple):
        return any(map(_not_finite, value))
    return hasattr(value, "__dict__") and _not_finite(vars(value))


def _too_slow(*_: object) -> None:
    raise TooSlow


def main(inputs: int, every: int, named: list[str], tell: Callable[[str], object]) -> int:
    """Attack the readers named, or all; returns the exit code."""
    logging.disable()
    warnings.simplefilter("ignore")
    foreign_arrays.MAX_SECONDS, foreign_arrays.MAX_MEMORY = 2, 1 << 30  # bombs end early
    resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESSES, MAX_ADDRESSES))
    signal.signal(signal.SIGALRM, _too_slow)
    failed = False
    for reader in READERS:
        if not named or reader.name in named:
            with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
                place = Path(folder) / "good"
                place.mkdir()
                row = Attack(reader, place).run(inputs, every)
            failed = failed or bool(row["failures"])
            tell(json.dumps(row) + "\n")
    return int(failed)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=200, help="drawn for each reader")
    parser.add_argument("--every", type=int, default=1, help="which of the kept ones are tried")
    parser.add_argument("--reader", action="append", default=[], help="one of them; all without")
    asked = parser.parse_args()
    raise SystemExit(main(asked.inputs, asked.every, asked.reader, sys.stdout.write))
