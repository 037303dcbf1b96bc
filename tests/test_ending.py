import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from deblur_avatar.ending import (
    STOPPED,
    STOPPED_WORDS,
    exit_code,
    leave_at_once,
    raise_again,
    uninterrupted,
)
from deblur_avatar.errors import ArtifactError, ConfigError, FittingError

ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def _interrupts():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def raising(error):
    def work():
        raise error

    return work


@pytest.mark.parametrize("kind", [ConfigError, ArtifactError, FittingError])
def test_what_a_caller_can_mend_is_one_line_whatever_a_parser_said(kind, capsys):
    error = kind("params.yaml is not YAML: while parsing\n  in line 1,\n      ^")
    assert exit_code(raising(error)) == 1
    said = capsys.readouterr().err
    assert said == f"{kind.__name__}: params.yaml is not YAML: while parsing in line 1, ^\n"


def test_what_a_caller_stops_ends_as_shells_expect(capsys):
    assert exit_code(raising(KeyboardInterrupt)) == STOPPED == 130
    assert capsys.readouterr().err == STOPPED_WORDS


def test_what_work_returns_is_the_code_and_nothing_is_0():
    assert exit_code(lambda: 3) == 3
    assert exit_code(lambda: None) == 0
    with pytest.raises(KeyError):
        exit_code(raising(KeyError("ours")))


def test_a_process_that_ignores_interrupts_goes_on_ignoring_them():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    leave_at_once()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    raise_again()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_interrupts_are_raised_again_once_all_is_loaded():
    leave_at_once()
    assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    raise_again()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_waits_for_what_is_not_to_be_broken_off():
    done = []

    def work():
        with uninterrupted():
            os.kill(os.getpid(), signal.SIGINT)
            done.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_within_is_itself_and_interrupts_are_raised_as_before():
    with pytest.raises(KeyError), uninterrupted():
        raise KeyError
    with uninterrupted():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_interrupt_does_not_wait():
    program = (
        "import os, signal; from deblur_avatar.ending import uninterrupted\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "with uninterrupted():\n"
        "    os.kill(os.getpid(), signal.SIGINT); os.kill(os.getpid(), signal.SIGINT)\n"
        "    os._exit(7)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], env={"PYTHONPATH": str(ROOT)}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (STOPPED, STOPPED_WORDS)


@pytest.mark.parametrize("answer", [signal.SIG_IGN, signal.SIG_DFL])
def test_who_answers_interrupts_otherwise_goes_on_doing_so(answer):
    signal.signal(signal.SIGINT, answer)
    with uninterrupted():
        assert signal.getsignal(signal.SIGINT) is answer
    assert signal.getsignal(signal.SIGINT) is answer


def test_other_threads_leave_interrupts_to_the_main_one():
    found = []

    def work():
        with uninterrupted():
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [signal.default_int_handler]


def test_it_is_loaded_in_no_time():
    program = "import deblur_avatar.loading, sys; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env={"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.stdout == "False\n"
