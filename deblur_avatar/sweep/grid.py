"""Parameter grid: every combination of values as one of DVC's experiments, each in its own clone.

Clones hold what is committed and share the cache, so that what combinations have in common is made
once. An experiment ends as a commit that `dvc exp show` and `dvc exp apply` know.
"""

import hashlib
import re
import sys
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

from deblur_avatar.errors import ConfigError
from deblur_avatar.sweep.tasks import Task

MEMORY_MB = 900.0  # of a fit at 192 pixels, with DVC
LONGEST = 200  # letters of a name, which git makes a file of: file systems take 255


def grid(asked: Sequence[str]) -> list[dict[str, str]]:
    """All combinations of `key=value,value,...`, the last key's values next to each other.

    Raises:
        ConfigError: for words that are none of that, or a key that comes twice.
    """
    values: dict[str, list[str]] = {}
    for word in asked:
        key, _, listed = word.partition("=")
        found = [value.strip() for value in listed.split(",")]
        if not key or not all(found):
            raise ConfigError(f"-S {word}: wanted key=value or key=value,value,...")
        if key in values:
            raise ConfigError(f"-S {word}: {key} is set twice")
        values[key] = found
    return [dict(zip(values, chosen, strict=True)) for chosen in product(*values.values())]


def name_of(target: str, chosen: dict[str, str]) -> str:
    """What an experiment is called: its target, each whole key and its value, as git allows.

    All of it, since an experiment takes the place of one of its name: that of another target, or of
    another key that ends in the same word, say. What would be too long ends in a digest.
    """
    whole = "_".join([target, *(f"{key}-{value}" for key, value in chosen.items())])
    name = re.sub(r"[^A-Za-z0-9_.-]|\.(?=\.|lock$|$)", "-", whole).lstrip(".-")
    digest = hashlib.sha256(whole.encode()).hexdigest()[:8]
    return name if len(name) <= LONGEST else f"{name[:LONGEST]}-{digest}"


def tasks_of(
    root: Path, target: str, combinations: Sequence[dict[str, str]], seconds: float, cores: int = 1
) -> dict[str, Task]:
    """A task a combination.

    Args:
        root: of the repository.
        target: a pipeline, or a stage of one.
        combinations: of `grid`.
        seconds: that one is expected to take.
        cores: that each is given.

    Raises:
        ConfigError: if two would have one name.
    """
    tasks = {}
    for chosen in combinations:
        name = name_of(target, chosen)
        if name in tasks:
            raise ConfigError(f"-S: two experiments would be called {name}; set fewer keys at once")
        command = tuple(_command(root, target, name, chosen))
        tasks[name] = Task(name, frozenset(), seconds, MEMORY_MB, cores, command)
    return tasks


def _command(root: Path, target: str, name: str, chosen: dict[str, str]) -> Iterator[str]:
    yield from (sys.executable, "-m", "deblur_avatar.sweep.experiment")
    yield from ("--root", str(root.resolve()), "--target", target, "--name", name)
    for key, value in chosen.items():
        yield from ("--set", f"{key}={value}")
