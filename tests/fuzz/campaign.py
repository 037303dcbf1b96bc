"""All hostile inputs of one reader, and what became of them."""

import logging
import os
import tempfile
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from tests.fuzz.guarded import Tally, in_child, try_input
from tests.fuzz.mutations import hostile
from tests.fuzz.readers import Reader
from tests.fuzz.recipes import recipes

LONGEST_S = 600.0  # for one reader


def campaign(
    reader: Reader, inputs: int, number: int, kept: Path | None = None, fixed: bool = True
) -> Tally:
    """Try the fixed recipes and `inputs` drawn ones on one reader, in a process of its own.

    Args:
        reader: which.
        inputs: how many are drawn.
        number: seed of the draws.
        kept: folder for the inputs that failed.
        fixed: whether the recipes are tried.
    """
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        here = Path(folder)
        return in_child(
            lambda: _all(reader, inputs, number, here, kept, fixed), reader.name, LONGEST_S
        )


def _all(
    reader: Reader, inputs: int, number: int, folder: Path, kept: Path | None, fixed: bool
) -> Tally:
    logging.disable()
    good = folder / "good"
    good.mkdir()
    reader.write(good)
    files = {path: path.read_bytes() for path in sorted(good.rglob("*")) if path.is_file()}
    tally, acts = Tally(reader.name), []
    os.chdir(good)

    def attempt(path: Path, content: bytes) -> None:
        known = set(tally.failures)
        path.write_bytes(content)
        if kept is not None:
            (kept / "last").write_bytes(content)  # should it end the process
        try_input(lambda: reader.read(good), tally, acts)
        path.write_bytes(files[path])
        for failure in set(tally.failures) - known:
            if kept is not None:
                name = f"{reader.name}-{failure}-{path.name}".replace("/", "_")[:150]
                (kept / name).write_bytes(content)

    try_input(lambda: reader.read(good), tally, acts)
    if not tally.read:
        tally.failures["good"] = "the undamaged file was refused"
    for path, content in files.items():
        for recipe in recipes(path.suffix, content) if fixed else ():
            attempt(path, recipe)

    @seed(number)
    @settings(
        max_examples=inputs,
        database=None,
        deadline=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def drawn(data: st.DataObject) -> None:
        path = data.draw(st.sampled_from(list(files)))
        attempt(path, data.draw(hostile(files[path], path.suffix)))

    if inputs:
        drawn()
    return tally
