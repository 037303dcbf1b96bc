"""View while fitting: at what share of its speed a fit goes on while its avatar is turned by hand.

    python -m benchmarks.view_while_fitting --json FILE [--observations FOLDER]

fits the studio (recipe `lean`, 6,000 Gaussians) and starts `deblur-avatar view` of it. By turns of
some seconds, so that whatever else the machine does and the growth of the fit fall on all alike:

- `alone`: nobody looks;
- `watched`: the avatar is turned without rest by a client that speaks viser's protocol and draws
  nothing, as next to nothing is left to the processor where a graphics card draws for the browser;
- `browser`: a Chromium in software GL is turned, the viewer stands still and sends no picture;
- `both`: that Chromium is turned, and the viewer draws for it.

Steps a second are counted by the clock: a fit's own processor time knows no neighbours.
"""

import argparse
import json
import math
import multiprocessing
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ruamel.yaml import YAML

from benchmarks.rasterizer import machine
from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.resume import run_folder
from deblur_avatar.training.schedule import ScheduleParams

PARAMS = Path("params.yaml")
SCENE, RUN, AVATAR = "studio", "studio-lean", "lean"
STEPS = 60_000  # more than the longest measurement sees
SNAPSHOT_EVERY = 1_000  # steps: more often than a run of the pipeline keeps one
FIRST_SNAPSHOT = 100
SCHEDULE = ScheduleParams(
    warmup=STEPS, trajectory=STEPS + 1, fusion=STEPS + 2, gaussians=6000, image_height=192,
    levels=(),
)  # fmt: skip
SETTLED = 1.0  # seconds after a switch that are not counted
WAIT = 180.0  # seconds for a process to be ready
MOVE_EVERY = 0.04  # seconds between two movements of the hand
PICTURE_BYTES = 1500  # what is larger of what the browser is sent is a picture
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def fit(folder: Path, observations: Path, step: Any) -> None:
    """Fit in a folder as the stage `warmup` does, until somebody stops it; counts its steps."""
    with run.stage("warmup", RUN, seed=0) as context:
        out = folder / "data/warmup" / f"{SCENE}-blurred-{AVATAR}"
        kept = frozenset({FIRST_SNAPSHOT, *range(SNAPSHOT_EVERY, STEPS, SNAPSHOT_EVERY)})

        def count(iteration: int, _: Any) -> None:
            step.value = iteration

        with run_folder(out, "view_while_fitting", kept) as place:
            warm_up(
                Observations.load(observations),
                load_params(PARAMS, f"avatars.{AVATAR}", RecipeParams), SCHEDULE,
                device=context.device, generator=context.generator, report=count, folder=place,
            )  # fmt: skip


def write_folder(folder: Path, observations: Path) -> None:
    """What `deblur-avatar view` reads of a run."""
    seen = folder / "data/preprocess" / SCENE / "blurred"
    seen.parent.mkdir(parents=True)
    seen.symlink_to(observations.resolve())
    entry = {"scene": SCENE, "observations": "blurred", "avatar": AVATAR, "method": "lean"}
    content = {
        "from": {"footage": "data"}, "schedule": "endless", "snapshots": 0, "runs": {RUN: entry},
        "schedules": {"endless": json.loads(SCHEDULE.model_dump_json())},
    }  # fmt: skip
    with (folder / PARAMS.name).open("w") as file:
        YAML().dump(content, file)


@contextmanager
def viewed(folder: Path) -> Iterator[tuple[int, str]]:
    """A viewer of the run in a folder: its process and its address."""
    command = [sys.executable, "-m", "deblur_avatar.cli.main", "view", RUN, "--port", "0"]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE) as viewer:
        assert viewer.stdout is not None
        lines = (re.search(rb"http://\S+", line) for line in viewer.stdout)
        found = next(filter(None, lines), None)
        if found is None:
            raise RuntimeError("the viewer ended before it said where it is")
        try:
            yield viewer.pid, found[0].decode()
        finally:
            viewer.send_signal(signal.SIGCONT)
            viewer.terminate()


class Socket:
    """A client of viser's that turns the avatar and draws nothing; `pictures` counts what came."""

    def __init__(self, address: str) -> None:
        import msgspec  # both viser's own
        import viser
        from websockets.sync.client import connect
        from websockets.typing import Subprotocol

        self.pictures, self._moves, self._packed = 0, 0, msgspec.msgpack.encode
        spoken = Subprotocol(f"viser-v{viser.__version__}")
        url = address.replace("http", "ws", 1)
        self._socket = connect(url, subprotocols=[spoken], max_size=None)
        threading.Thread(target=self._receive, daemon=True).start()

    def turn(self, seconds: float) -> None:
        """Round and round."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._moves += 1
            angle = 0.05 * self._moves  # about +Y, three metres from the middle
            half = angle / 2
            message = {
                "type": "ViewerCameraMessage", "fov": 0.8, "near": 0.1, "far": 100.0,
                "position": (-3 * math.sin(angle), 0.0, -3 * math.cos(angle)),
                "wxyz": (math.cos(half), 0.0, math.sin(half), 0.0),
                "image_height": 800, "image_width": 1280,
                "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 1.0, 0.0),
            }  # fmt: skip
            self._socket.send(self._packed(message))
            time.sleep(MOVE_EVERY)

    def _receive(self) -> None:
        for content in self._socket:
            self.pictures += len(content) > PICTURE_BYTES


class Hand:
    """A browser that turns the avatar; `pictures` counts what it was sent."""

    def __init__(self, browser: Any, address: str) -> None:
        self.pictures, self._moves = 0, 0
        self._page = browser.new_page(viewport={"width": 1280, "height": 800})
        self._page.on("websocket", lambda socket: socket.on("framereceived", self._received))
        self._page.goto(address)
        end = time.monotonic() + WAIT
        while self.pictures == 0 and time.monotonic() < end:
            self._page.wait_for_timeout(1000 * SETTLED)
        self._page.mouse.move(400, 400)
        self._page.mouse.down()

    def turn(self, seconds: float) -> None:
        """Round and round."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._moves += 1
            angle = 0.1 * self._moves
            self._page.mouse.move(400 + 150 * math.cos(angle), 400 + 60 * math.sin(angle))
            self._page.wait_for_timeout(1000 * MOVE_EVERY)

    def _received(self, content: str | bytes) -> None:
        self.pictures += len(content) > PICTURE_BYTES


def descendants(root: int) -> list[int]:
    """Processes that a process started, and what these started."""
    parents = {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(place.parent.name)] = int(place.read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has ended
            continue
    found, waiting = [], [root]
    while waiting:
        above = waiting.pop()
        below = [pid for pid, parent in parents.items() if parent == above]
        found += below
        waiting += below
    return found


def speed(step: Any, let_pass: Callable[[float], None], seconds: float) -> float:
    """Steps a second while time passes."""
    let_pass(SETTLED)
    begin, first = time.monotonic(), step.value
    let_pass(seconds)
    return float((step.value - first) / (time.monotonic() - begin))


@contextmanager
def stopped(processes: Sequence[int]) -> Iterator[None]:
    """Let these processes stand still meanwhile."""
    for pid in processes:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in processes:
            os.kill(pid, signal.SIGCONT)


def turns(
    step: Any, clients: Mapping[str, Any], viewer: Sequence[int], browser: Sequence[int],
    rounds: int, seconds: float,
) -> list[dict[str, float]]:  # fmt: skip
    """Speeds, a row a round."""
    socket, hand = clients["watched"], clients["both"]
    rows = []
    for _ in range(rounds):
        row = {}
        with stopped([*viewer, *browser]):
            row["alone"] = speed(step, time.sleep, seconds)
        with stopped(browser):
            before = socket.pictures
            row["watched"] = speed(step, socket.turn, seconds)
            row["watched_pictures"] = (socket.pictures - before) / (seconds + SETTLED)
        with stopped(viewer):
            row["browser"] = speed(step, hand.turn, seconds)
        before = hand.pictures
        row["both"] = speed(step, hand.turn, seconds)
        row["both_pictures"] = (hand.pictures - before) / (seconds + SETTLED)
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def summary(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Means of all turns, and what share of a speed the viewer leaves: of the fit's own, and of
    that beside a browser, whose drawing is not the viewer's.
    """
    means = {name: statistics.fmean(row[name] for row in rows) for name in rows[0]}
    return means | {
        "share_watched": means["watched"] / means["alone"],
        "share_beside_browser": means["both"] / means["browser"],
        "share_with_browser": means["both"] / means["alone"],
    }


def wait_until(true: Callable[[], bool], fitting: BaseProcess) -> None:
    """Until something is so; a fit that ends first, or WAIT, is an error."""
    end = time.monotonic() + WAIT
    while not true():
        if time.monotonic() > end or not fitting.is_alive():
            raise RuntimeError("the fit did not come so far")
        time.sleep(0.1)


def measured(observations: Path, rounds: int, seconds: float) -> list[dict[str, float]]:
    """Fit, view, turn, count; a row a round."""
    from playwright.sync_api import sync_playwright  # of the extra `dev`

    context = multiprocessing.get_context("spawn")
    step = context.Value("q", 0, lock=False)
    with TemporaryDirectory() as there:
        write_folder(Path(there), observations)
        fitting = context.Process(target=fit, args=(Path(there), observations, step), daemon=True)
        fitting.start()
        assert fitting.pid is not None
        try:
            wait_until(lambda: step.value > FIRST_SNAPSHOT + 1, fitting)
            binary = next(filter(None, map(shutil.which, CHROMIUM)), None)
            with viewed(Path(there)) as (viewer, address), sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=binary, args=list(FLAGS))
                clients: dict[str, Hand | Socket] = {
                    "both": Hand(browser, address),
                    "watched": Socket(address),
                }
                for client in clients.values():
                    client.turn(SETTLED)
                drawing = [viewer, *descendants(viewer)]
                rest = {*descendants(os.getpid())} - {*drawing, fitting.pid}
                rows = turns(step, clients, drawing, sorted(rest), rounds, seconds)
                browser.close()
                return rows
        finally:
            fitting.kill()
            fitting.join()


def main(arguments: argparse.Namespace) -> None:
    """Measure, print, and write."""
    record: dict[str, Any] = {"machine": machine(0.0)}
    record["turns"] = measured(arguments.observations, arguments.rounds, arguments.seconds)
    record |= summary(record["turns"])
    if arguments.json:
        write_json(arguments.json, record)
    print(json.dumps(record, indent=1))


def _arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file")
    parser.add_argument(
        "--observations", type=Path, default=Path("data/preprocess/studio/blurred"),
        help="of the studio, as `dvc repro preprocess@studio` makes them",
    )  # fmt: skip
    parser.add_argument("--rounds", type=int, default=10, help="of the four turns")
    parser.add_argument("--seconds", type=float, default=5.0, help="of a turn")
    return parser.parse_args(words)


if __name__ == "__main__":
    main(_arguments())
