import pytest

from deblur_avatar.errors import ArtifactError
from tests.fuzz.campaign import campaign
from tests.fuzz.guarded import Tally, in_child, try_input
from tests.fuzz.readers import READERS, Reader

SAMPLE = 12  # drawn inputs a reader; `make fuzz` draws 250, and all the recipes


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_hostile_files_are_read_or_refused_with_an_error_of_our_own(reader: Reader):
    tally = campaign(reader, SAMPLE, 0, fixed=False)
    assert not tally.failures
    assert tally.inputs > SAMPLE / 2
    assert tally.read
    assert tally.refused


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
    def work() -> Tally:
        tally = Tally("it")
        try_input(read, tally, [])
        return tally

    failures = in_child(work, "it", 30.0).failures
    assert failure in " ".join(failures.values())


def test_a_reader_that_ends_the_process_is_found_out():
    def work() -> Tally:
        __import__("os")._exit(7)

    assert in_child(work, "it", 30.0).failures == {"child": "the process died with exit code 7"}
