import pytest

from deblur_avatar.errors import ArtifactError
from tests.fuzz.guarded import Tally, in_child, try_input


def test_hostile_files_are_read_or_refused_with_an_error_of_our_own(sample):
    assert not {name: row["failures"] for name, row in sample.items() if row["failures"]}


def test_every_reader_reads_its_own_file_and_refuses_some_other(sample):
    for name, row in sample.items():
        assert row["read"], name
        assert row["refused"], name


def _crash() -> object:
    raise KeyError("poses")


def _allocate() -> object:
    try:
        return bytearray(10**13)
    except MemoryError:
        raise ArtifactError("too large") from None


def _execute() -> object:
    return __import__("os").system("true")


def _nothing_finite() -> object:
    return {"a": [float("nan")]}


@pytest.mark.parametrize(
    ("read", "failure"),
    [
        (_crash, "KeyError"),
        (_allocate, "in vain"),
        (_execute, "was done while"),
        (_nothing_finite, "not finite"),
    ],
)
def test_a_reader_that_does_wrong_is_found_out(read, failure):
    def work(_: object) -> Tally:
        tally = Tally("it")
        try_input(read, tally, [])
        return tally

    tally = in_child(work, Tally("it"), 30.0)
    assert tally.finished
    assert failure in " ".join([*tally.failures, *tally.failures.values()])


def test_a_reader_that_ends_the_process_is_found_out_and_what_was_known_stays():
    def work(tell) -> Tally:
        tell(Tally("it", inputs=3))
        __import__("os")._exit(7)

    tally = in_child(work, Tally("it"), 30.0)
    assert not tally.finished
    assert tally.failures == {"input 3": "the process ended with exit code 7"}
