"""The scheduler on an engine that a test drives, and forecasts."""

from collections.abc import Callable

import pytest

from deblur_avatar.sweep.commands import end_of
from deblur_avatar.sweep.scheduler import Ended, work_off
from deblur_avatar.sweep.simulated_engine import forecasts, table
from deblur_avatar.sweep.tasks import Task, critical_path, remaining_path


def task(name: str, needs: str = "", seconds: float = 1.0, cores: int = 1) -> Task:
    return Task(name, frozenset(needs), seconds, 100.0, cores, ())


def graph(*tasks: Task) -> dict[str, Task]:
    return {one.name: one for one in tasks}


class Driven:
    """Runs one task after the other, each ending as it is told."""

    def __init__(self, room: int, end_of: Callable[[str, int], str]) -> None:
        self.room, self.end_of = room, end_of
        self.begun: list[str] = []
        self.clock = 0.0
        self.running: list[str] = []
        self.stopped = False

    def has_room(self, task: Task) -> bool:
        return len(self.running) < self.room

    def start(self, task: Task) -> None:
        self.begun.append(task.name)
        self.running.append(task.name)

    def wait(self, seconds: float) -> Ended | None:
        self.clock += seconds
        if not self.running:
            return None
        name = self.running.pop(0)
        end = self.end_of(name, self.begun.count(name))
        return Ended(name, end, "said", "here", 2.0)  # type: ignore[arg-type]

    def seconds(self) -> float:
        return self.clock

    def stop(self) -> None:
        self.stopped = True


def unseen(progress, ended):
    pass


#   a - c - e     b - d      f
NET = graph(
    task("a", seconds=1), task("b", seconds=5), task("c", "a", 9), task("d", "b", 1),
    task("e", "c", 1), task("f", seconds=7),
)  # fmt: skip


def test_what_most_still_waits_for_goes_first_and_nothing_before_what_it_needs():
    engine = Driven(1, lambda name, time: "done")
    progress = work_off(NET, engine, unseen)
    assert engine.begun == ["a", "c", "f", "b", "d", "e"]
    assert progress.done == set("abcdef")
    assert progress.took == dict.fromkeys("abcdef", 2.0)
    assert engine.stopped


def test_no_more_begins_than_there_is_room_for():
    most = 0

    def end(name: str, time: int) -> str:
        nonlocal most
        most = max(most, len(engine.running) + 1)
        return "done"

    engine = Driven(2, end)
    work_off(NET, engine, unseen)
    assert most == 2


def test_a_failure_is_not_tried_again_and_leaves_those_that_need_it_alone():
    engine = Driven(2, lambda name, time: "failed" if name == "a" else "done")
    progress = work_off(NET, engine, unseen)
    assert progress.failed == {"a": "said"}
    assert progress.left == {"c", "e"}
    assert progress.done == {"b", "d", "f"}
    assert engine.begun.count("a") == 1


@pytest.mark.parametrize(("times", "ends_well"), [(1, True), (2, True), (3, False)])
def test_a_lost_task_is_begun_again_so_often_and_no_more(times, ends_well):
    engine = Driven(2, lambda name, time: "lost" if name == "b" and time <= times else "done")
    progress = work_off(NET, engine, unseen, retries=2)
    assert engine.begun.count("b") == min(times + 1, 3)
    assert ("b" in progress.done) is ends_well
    assert progress.left == (set() if ends_well else {"d"})


def test_a_lost_task_waits_longer_each_time_and_holds_up_no_other():
    engine, began = Driven(1, lambda name, time: "lost" if time <= 2 else "done"), []
    start = engine.start

    def noted(task: Task) -> None:
        began.append((task.name, engine.clock))
        start(task)

    engine.start = noted  # type: ignore[method-assign]
    work_off(graph(task("a", seconds=2), task("b")), engine, unseen, retries=2)
    assert began == [("a", 0), ("b", 1), ("a", 4), ("b", 5), ("a", 11), ("b", 12)]


def test_the_engine_is_stopped_when_the_watch_raises():
    def interrupted(progress, ended):
        raise KeyboardInterrupt

    engine = Driven(2, lambda name, time: "done")
    with pytest.raises(KeyboardInterrupt):
        work_off(NET, engine, interrupted)
    assert engine.stopped


def test_a_task_too_large_for_the_engine_runs_alone():
    engine = Driven(0, lambda name, time: "done")
    assert work_off(NET, engine, unseen).done == set("abcdef")


def test_paths_through_the_graph():
    assert remaining_path(NET) == {"a": 11, "b": 6, "c": 10, "d": 1, "e": 1, "f": 7}
    assert critical_path(NET) == 11
    assert critical_path({}) == 0


def test_needs_that_are_up_to_date_already_are_not_waited_for():
    engine = Driven(1, lambda name, time: "done")
    assert work_off(graph(task("c", "a")), engine, unseen).done == {"c"}


def test_a_forecast_never_beats_the_longest_chain_nor_the_sum_of_work():
    one, two, many = forecasts(NET, [1, 2, 50], start=0.0)
    assert (one.seconds, one.speedup, one.efficiency) == (24, 1, 1)
    assert two.seconds == 13  # c ends at 10; f, b, d need 13 seconds of the other worker
    assert many.seconds == critical_path(NET) == 11
    assert many.speedup == pytest.approx(24 / 11)
    assert many.efficiency == pytest.approx(24 / 11 / 50)


def test_starting_costs_and_wide_tasks_count():
    net = graph(task("a", cores=2, seconds=4), task("b", seconds=4))
    (two,) = forecasts(net, [2], start=1.0)
    assert two.seconds == 10
    assert two.speedup == pytest.approx(15 / 10)


def test_the_table_says_what_was_forecast():
    lines = table(NET, forecasts(NET, [1, 2], start=0.0))
    assert lines[2] == "| 1 | 0.01 | 1.0 | 100% |"
    assert lines[-1] == "6 tasks; the longest chain of them takes 0.00 hours."


@pytest.mark.parametrize(
    ("code", "said", "end"),
    [
        (0, "", "done"),
        (255, "ERROR: failed to reproduce 'fit': failed to run: fit, exited with 1", "failed"),
        (255, "ERROR: failed to reproduce 'fit': failed to run: fit, exited with 128", "failed"),
        (255, "ERROR: failed to reproduce 'fit': failed to run: fit, exited with -9", "lost"),
        (255, "ERROR: failed to reproduce 'fit': failed to run: fit, exited with 137", "lost"),
        (255, "ERROR: Unable to acquire lock", "lost"),
        (-9, "", "lost"),
        (137, "", "lost"),
        (2, "usage", "failed"),
    ],
)
def test_a_process_that_was_killed_is_lost_whatever_shell_began_it(code, said, end):
    assert end_of(code, said) == end
