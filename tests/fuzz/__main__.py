"""All of it: `make fuzz`, or `python -m tests.fuzz`, which says a row a reader.

Ends with code 1 if an input was neither read nor refused.
"""

import argparse
import dataclasses
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

# Before anything of the package is imported: readers must do without checks of shapes.
os.environ["DEBLUR_AVATAR_CHECK_SHAPES"] = "0"

ROW = "{:<24} {:>7} {:>7} {:>8} {:>7} {:>8} {:>10}\n"
HEADS = ("reader", "inputs", "read", "refused", "places", "peak MB", "longest s")


def main(inputs: int, every: int, named: list[str], kept: Path, json_file: Path | None) -> int:
    """Run the campaigns of the readers named, or of all; returns the exit code."""
    from tests.fuzz.campaign import campaign
    from tests.fuzz.readers import READERS

    names = [reader.name for reader in READERS]
    if not set(named) <= set(names):
        raise SystemExit(f"no such reader, there are {', '.join(names)}")
    kept.mkdir(parents=True, exist_ok=True)
    where = machine()
    sys.stdout.write(ROW.format(*HEADS))
    rows, begin = [], time.monotonic()
    for reader in [reader for reader in READERS if not named or reader.name in named]:
        tally = campaign(reader, inputs, 0, kept, every)
        rows.append(dataclasses.asdict(tally))
        numbers = (tally.inputs, tally.read, tally.refused, len(tally.failures))
        costs = f"{tally.peak_mb:.0f}", f"{tally.slowest_s:.2f}"
        sys.stdout.write(ROW.format(reader.name, *numbers, *costs))
        sys.stdout.writelines(f"    {place}: {what}\n" for place, what in tally.failures.items())
        sys.stdout.flush()
    total = sum(row["inputs"] for row in rows)
    places = sum(len(row["failures"]) for row in rows)
    sys.stdout.write(
        f"{total} inputs in {time.monotonic() - begin:.0f} s; failures at {places} places"
        f"{f'; the inputs that failed are in {kept}' if places else ''}\n"
    )
    if json_file is not None:
        record = {"machine": where, "inputs": total, "rows": rows}
        json_file.write_text(json.dumps(record, indent=1) + "\n")
    return int(places > 0)


def machine() -> dict[str, Any]:
    """Where and with what the numbers were taken, without what only rasterizers depend on."""
    from benchmarks import rasterizer

    found = rasterizer.machine(0.0)
    return {key: found[key] for key in ("commit", "cpu", "cores", "system", "python", "torch")}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=200, help="drawn for each reader")
    parser.add_argument("--every", type=int, default=1, help="which of the fixed ones are tried")
    parser.add_argument("--reader", action="append", default=[], help="one of them; all without")
    parser.add_argument("--kept", type=Path, help="folder for the inputs that failed")
    parser.add_argument("--json", type=Path, help="write the record to this file")
    asked = parser.parse_args()
    folder = asked.kept or Path(tempfile.mkdtemp(prefix="fuzz-failures-"))
    raise SystemExit(main(asked.inputs, asked.every, asked.reader, folder, asked.json))
