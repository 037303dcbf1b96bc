"""Profiled steps: how much of a step's time each kind of work takes, and each marked part.

The profiler writes down thousands of calls a step, most of them short, and a step takes longer for
it. Steps are therefore recorded and left alone in turns, and what the recorded ones take more is
taken off every call in equal parts: shares are of the step as it runs without a profiler.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch.autograd.profiler_util import FunctionEvent
from torch.profiler import ProfilerActivity, profile, record_function

WARM_UP = 10
TURN = 6  # steps
TURNS = 10  # of a record

# The profiler's names of products of matrices, besides oneDNN's.
PRODUCTS = ("mm", "addmm", "bmm", "baddbmm", "mv", "addmv", "addmv_", "convolution_backward")
PART = "part: "

Step = Callable[[int], Any]


class Record(NamedTuple):
    """What a profiler saw of some steps.

    calls: each with the milliseconds of a step that it took itself, without those it called.
    alone: milliseconds that a step took without the profiler, in the same minute.
    """

    calls: list[tuple[FunctionEvent, float]]
    alone: float

    def without_profiler(self) -> "Record":
        """The same calls, each without its part of the time that recording took."""
        cost = (sum(took for _, took in self.calls) - self.alone) / len(self.calls)
        return Record([(call, took - cost) for call, took in self.calls], self.alone)


def record(step: Step) -> Record:
    """Turns of steps with a profiler and without, the first step of each as in `milliseconds`."""
    for index in range(WARM_UP):
        step(index)
    events: list[FunctionEvent] = []
    alone = 0.0
    for _ in range(TURNS):
        _touch_the_heap()
        step(WARM_UP)
        start = time.perf_counter()
        for index in range(WARM_UP + 1, WARM_UP + TURN):
            step(index)
        alone += time.perf_counter() - start
        _touch_the_heap()
        step(WARM_UP)
        with profile(activities=[ProfilerActivity.CPU]) as profiler:
            for index in range(WARM_UP + 1, WARM_UP + TURN):
                with record_function(PART + "other"):
                    step(index)
        events += profiler.events()
    steps = TURNS * (TURN - 1)
    return Record([(event, 1e-3 * event.self_cpu_time_total / steps) for event in events],
                  1e3 * alone / steps)  # fmt: skip


def _touch_the_heap() -> None:
    """Take memory and free it, for what is recorded to be kept in.

    Otherwise the record pushes the heap's end on while a step runs, and the step waits for
    thousands of new pages (10 to 25 ms), as it never does without a profiler.
    """
    blocks = [torch.zeros(2**21) for _ in range(80)]  # 640 MB
    del blocks


def mark(function: Callable[..., Any], part: str) -> Callable[..., Any]:
    """A function whose calls a record knows as of this part."""

    def marked(*arguments: Any, **named: Any) -> Any:
        with record_function(PART + part):
            return function(*arguments, **named)

    return marked


def shares_of_parts(record: Record) -> dict[str, float]:
    """Shares of marked parts; a backward call is of the part whose forward call has its number."""
    forward: dict[int, str] = {}
    for event, _ in record.calls:
        # Posing happens between the marked calls, in the step itself.
        part = "skinning" if event.name == "_Posing" else _part(event)
        backward = "evaluate_function" in event.name or "Backward" in event.name
        if event.sequence_nr >= 0 and part and not backward:
            forward.setdefault(event.sequence_nr, part)
    spent: dict[str, float] = defaultdict(float)
    for event, took in record.without_profiler().calls:
        part = _part(event) or "other"
        above: FunctionEvent | None = event
        while above is not None:
            if "evaluate_function" in above.name:
                part = forward.get(above.sequence_nr, "other")
                break
            if above.name == "_Posing":
                part = "skinning"
                break
            above = above.cpu_parent
        spent[part] += took
    return _shares(spent)


def shares_of_work(record: Record) -> dict[str, Any]:
    """Shares of kinds of work, of products among them, and what was recorded."""
    spent, products = _kinds(record.without_profiler())
    total = sum(spent.values())
    recorded, recorded_products = _kinds(record)
    return {
        "work": _shares(spent),
        "matrix products": round(products / total, 4),
        "rasterizer_and_products": _rasterizer_and_products(spent, products),
        "recorded": {
            "ms": round(sum(recorded.values()), 2),
            "alone_ms": round(record.alone, 2),
            "rasterizer_and_products": _rasterizer_and_products(recorded, recorded_products),
        },
    }


def _kinds(record: Record) -> tuple[dict[str, float], float]:
    """Milliseconds by kind of work, and those of products in the narrow sense."""
    spent: dict[str, float] = defaultdict(float)
    products = 0.0
    for event, took in record.calls:
        spent[_kind(event)] += took
        if event.name.startswith("mkldnn::") or event.name.removeprefix("aten::") in PRODUCTS:
            products += took
    return spent, products


def _rasterizer_and_products(spent: Mapping[str, float], products: float) -> float:
    native = sum(
        spent[kind] for kind in ("rasterizer", "posing kernel", "covariance factors kernel")
    )
    return round((native + products) / sum(spent.values()), 4)


def _shares(spent: Mapping[str, float]) -> dict[str, float]:
    total = sum(spent.values())
    return {name: round(value / total, 4) for name, value in sorted(spent.items())}


def _part(event: FunctionEvent | None) -> str | None:
    while event is not None:
        if event.name.startswith(PART):
            return event.name.removeprefix(PART)
        event = event.cpu_parent
    return None


def _kind(event: FunctionEvent | None) -> str:
    kernels = {
        "_Rasterize": "rasterizer",
        "_Posing": "posing kernel",
        "_CovarianceFactors": "covariance factors kernel",
        "_Covariances": "covariance factors kernel",
        "_Isometry": "isometry kernel",
        "_Smoothness": "smoothness kernel",
        "_PoseSpline": "trajectory kernel",
        "_KnotDistance": "trajectory kernel",
        "_PictureLosses": "losses kernel",
        "_Layers": "layers",
    }
    while event is not None:
        for name, kind in kernels.items():
            if event.name in (name, f"{name}Backward"):
                return kind
        event = event.cpu_parent
    return "other"
