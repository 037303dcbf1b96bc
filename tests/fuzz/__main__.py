"""All of it: `make fuzz`, or `python -m tests.fuzz`, which says a row a reader.

Ends with code 1 if an input was neither read nor refused and no known defect explains it.
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


def main(inputs: int, every: int, kept: Path, json_file: Path | None) -> int:
    """Run every reader's campaign; returns the exit code."""
    from tests.fuzz.campaign import campaign, only
    from tests.fuzz.known_defects import KNOWN, unknown
    from tests.fuzz.readers import READERS

    kept.mkdir(parents=True, exist_ok=True)
    where = machine()
    sys.stdout.write(ROW.format(*HEADS))
    rows, new, begin = [], 0, time.monotonic()
    for reader in READERS:
        tally = campaign(reader, inputs, 0, kept, every)
        rows.append(dataclasses.asdict(tally))
        new += len(unknown(reader.name, tally.failures))
        numbers = (tally.inputs, tally.read, tally.refused, len(tally.failures))
        costs = f"{tally.peak_mb:.0f}", f"{tally.slowest_s:.2f}"
        sys.stdout.write(ROW.format(reader.name, *numbers, *costs))
        sys.stdout.writelines(f"    {place}: {what}\n" for place, what in tally.failures.items())
        sys.stdout.flush()
    total = sum(row["inputs"] for row in rows)
    places = sum(len(row["failures"]) for row in rows)
    sys.stdout.write(
        f"{total} inputs in {time.monotonic() - begin:.0f} s; failures at {places} places, {new} "
        f"of them unknown; the inputs that failed are in {kept}\n"
    )
    if json_file is not None:
        by_name = {reader.name: reader for reader in READERS}
        defects = [only(by_name[d.reader], d.file, d.content).failures for d in KNOWN]
        record = {"machine": where, "inputs": total, "rows": rows, "defects": defects}
        json_file.write_text(json.dumps(record, indent=1) + "\n")
    return int(new > 0)


def machine() -> dict[str, Any]:
    """Where and with what the numbers were taken, without what only rasterizers depend on."""
    from benchmarks import rasterizer

    found = rasterizer.machine(0.0)
    return {key: found[key] for key in ("commit", "cpu", "cores", "system", "python", "torch")}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=200, help="drawn for each reader")
    parser.add_argument("--every", type=int, default=1, help="which of the fixed ones are tried")
    parser.add_argument("--kept", type=Path, help="folder for the inputs that failed")
    parser.add_argument("--json", type=Path, help="write the record to this file")
    asked = parser.parse_args()
    folder = asked.kept or Path(tempfile.mkdtemp(prefix="fuzz-failures-"))
    raise SystemExit(main(asked.inputs, asked.every, folder, asked.json))
