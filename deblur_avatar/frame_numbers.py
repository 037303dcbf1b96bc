"""Frame numbers in a sentence."""

from collections.abc import Sequence

TOLD = 20  # runs of frames at most that a line of a log names


def spans(numbers: Sequence[int]) -> str:
    """Numbers in rising order as runs, as in "3, 17 to 40, 52"; of many runs the first ones."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    told = [f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs[:TOLD]]
    left = len(numbers) - sum(map(len, runs[:TOLD]))
    return ", ".join(told) + (f" and {left} more" if left else "")
