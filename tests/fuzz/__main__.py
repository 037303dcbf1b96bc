"""All of it: `make fuzz`, or `python -m tests.fuzz [inputs for each reader] [folder for failures]`.

Prints a row a reader, and ends with code 1 if any input was neither read nor refused.
"""

import os
import sys
import tempfile
from pathlib import Path

os.environ["DEBLUR_AVATAR_CHECK_SHAPES"] = "1"  # before anything of the package is imported

ROW = "{:<24} {:>7} {:>7} {:>8} {:>8} {:>9} {:>9}\n"


def main(inputs: int, kept: Path) -> int:
    """Run every reader's campaign; returns the exit code."""
    from tests.fuzz.campaign import campaign
    from tests.fuzz.readers import READERS

    sys.stdout.write(
        ROW.format("reader", "inputs", "read", "refused", "failed", "peak MB", "slowest s")
    )
    total = failed = 0
    for reader in READERS:
        tally = campaign(reader, inputs, 0, kept)
        total, failed = total + tally.inputs, failed + len(tally.failures)
        numbers = (tally.inputs, tally.read, tally.refused, len(tally.failures))
        times = f"{tally.peak_mb:.0f}", f"{tally.slowest_s:.2f}"
        sys.stdout.write(ROW.format(reader.name, *numbers, *times))
        sys.stdout.writelines(f"    {place}: {what}\n" for place, what in tally.failures.items())
        sys.stdout.flush()
    sys.stdout.write(f"{total} inputs, {failed} failures; the inputs that failed are in {kept}\n")
    return int(failed > 0)


if __name__ == "__main__":
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp(prefix="fuzz-failures-"))
    raise SystemExit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 250, folder))
