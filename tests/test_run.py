import logging
import os
import random
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

from deblur_avatar import ending, run
from deblur_avatar.errors import ArtifactError, ConfigError
from tests.process_state import process_state_kept


@pytest.fixture(autouse=True)
def global_state():
    with process_state_kept():
        yield


def test_seeds_are_the_same_on_every_machine_and_differ_between_stages_and_items():
    # The first eight digits of `printf 0/warmup/studio | sha256sum`.
    assert run.derive_seed(0, "warmup", "studio") == 0xCF69DF00
    seeds = {
        run.derive_seed(seed, stage, item)
        for seed in (0, 1)
        for stage in ("warmup", "fusion")
        for item in ("studio", "courtyard")
    }
    assert len(seeds) == 8
    assert all(0 <= seed < 2**32 for seed in seeds)


def test_what_was_renamed_draws_what_it_drew_before():
    # The seed of fusion@studio-blind, as its results in git were made.
    assert run.derive_seed(0, "fusion", "studio-agnostic") == 2234952903
    assert run.derive_seed(0, "fusion", "agnosticism") != run.derive_seed(0, "fusion", "blindism")


def draws(seed, item="studio"):
    with run.stage("warmup", item, seed) as context:
        own = torch.rand(3, generator=context.generator, device=context.device).tolist()
        return own, torch.rand(3).tolist(), np.random.rand(3).tolist(), random.random()  # noqa: NPY002


def test_a_stage_draws_the_same_numbers_whenever_it_runs(monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu")
    first, again, other_seed, other_item = draws(0), draws(0), draws(1), draws(0, "courtyard")
    assert first == again
    for other in (other_seed, other_item):
        assert all(a != b for a, b in zip(first, other, strict=True))


def test_a_stage_is_deterministic_and_does_not_load_the_compiler_of_torch_for_it():
    """That takes seconds, in each of a pipeline's stages."""
    program = (
        "import sys, torch; from deblur_avatar import run\n"
        "with run.stage('warmup', 'studio', 0):\n"
        "    assert torch.are_deterministic_algorithms_enabled()\n"
        "    assert not torch.is_deterministic_algorithms_warn_only_enabled()\n"
        "print([name for name in ('torch._dynamo', 'torch._inductor') if name in sys.modules])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env={**os.environ, "DEBLUR_AVATAR_DEVICE": "cpu"},
    )  # fmt: skip
    assert done.stdout == "[]\n"


def test_work_side_by_side_comes_back_in_order(monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_THREADS", "3")
    meeting = threading.Barrier(3, timeout=20)

    def work(number, word):
        meeting.wait()  # nobody goes on alone
        return f"{number}{word}"

    assert run.in_threads(work, range(6), "abcdef") == ["0a", "1b", "2c", "3d", "4e", "5f"]
    assert run.in_threads(work, [], []) == []


def test_work_side_by_side_says_what_went_wrong():
    def work(number):
        if number == 3:
            raise ArtifactError("the third")
        return number

    with pytest.raises(ArtifactError, match="the third"):
        run.in_threads(work, range(50))
    with pytest.raises(ValueError, match="zip"):
        run.in_threads(lambda a, b: a + b, [1, 2], [1])


def test_a_stage_runs_where_the_environment_says(monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu")
    with run.stage("warmup", "studio", 0) as context:
        assert context.device == torch.device("cpu")
        assert context.generator.device == context.device
        assert context.seed == run.derive_seed(0, "warmup", "studio")


@pytest.mark.parametrize(("gpu", "gsplat", "device"), [
    (False, True, "cpu"), (True, False, "cpu"), (True, True, "cuda"),
])  # fmt: skip
def test_a_gpu_is_used_where_its_rasterizer_is_installed(gpu, gsplat, device, monkeypatch, caplog):
    monkeypatch.delenv("DEBLUR_AVATAR_DEVICE", raising=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpu)
    monkeypatch.setattr(run, "find_spec", lambda name: "gsplat" if gsplat else None)
    monkeypatch.setattr(torch, "Generator", lambda device: None)
    with caplog.at_level("INFO"):
        assert run.chosen_device().type == device
    assert ("pip install 'deblur-avatar[cuda]'" in caplog.text) == (gpu and not gsplat)


def test_a_gpu_that_is_not_there_is_a_mistake_of_the_caller(monkeypatch):
    if torch.cuda.is_available():
        pytest.skip("there is one here")
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cuda")
    with pytest.raises(ConfigError, match="DEBLUR_AVATAR_DEVICE: "):
        run.chosen_device()


def test_a_device_that_does_not_exist_is_a_mistake_of_the_caller(monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "graphics")
    with (
        pytest.raises(ConfigError, match="DEBLUR_AVATAR_DEVICE: .*graphics"),
        run.stage("warmup", "studio", 0),
    ):
        pass


@pytest.mark.parametrize(("error", "said"), [
    (torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 108.00 MiB. GPU 0 has a total"),
     r"warmup studio: this GPU's memory is full \(CUDA out of memory\).*DEBLUR_AVATAR_DEVICE=cpu"),
    (MemoryError("Unable to allocate 3 GiB"),
     r"warmup studio: this machine's memory is full \(Unable to allocate 3 GiB\).*clip.frames"),
])  # fmt: skip
def test_full_memory_is_one_line_that_says_what_to_do(error, said):
    def allocate():
        with run.stage("warmup", "studio", 0):
            raise error

    with pytest.raises(ConfigError, match=said):
        allocate()


def test_torch_computes_with_one_thread_in_a_stage_and_kernels_with_more(monkeypatch):
    with run.one_thread():  # restores the number of threads that other tests have
        torch.set_num_threads(2)
        monkeypatch.setenv("DEBLUR_AVATAR_THREADS", "3")
        with run.stage("warmup", "studio", 0):
            assert torch.get_num_threads() == 1
            assert run.kernel_threads() == 3
    monkeypatch.delenv("DEBLUR_AVATAR_THREADS")
    assert 1 <= run.kernel_threads() <= 4


def test_waiting_threads_sleep():
    """Those that spin take a core away from whatever else runs, and from each other."""
    said = "import os, deblur_avatar; print(os.environ['OMP_WAIT_POLICY'])"
    for policy, wanted in ((None, "PASSIVE"), ("ACTIVE", "ACTIVE")):
        environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
        environment |= {} if policy is None else {"OMP_WAIT_POLICY": policy}
        told = subprocess.run(
            [sys.executable, "-c", said],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert told.stdout.strip() == wanted


@pytest.mark.parametrize("threads", ["0", "-1", "two", "1.5", "100000", ""])
def test_a_number_of_threads_that_is_none_is_refused(threads, monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_THREADS", threads)
    with (
        pytest.raises(ConfigError, match="DEBLUR_AVATAR_THREADS: wanted 1 to 1024, got"),
        run.stage("warmup", "studio", 0),
    ):
        pass


def test_a_stage_says_when_it_starts_and_what_it_took(caplog, monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu")
    with caplog.at_level(logging.INFO), run.stage("warmup", "studio", 0) as context:
        pass
    first, last = caplog.messages
    assert first == f"warmup studio: start, device cpu, seed {context.seed}"
    assert re.fullmatch(r"warmup studio: done in \d+\.\d s, \d+ MB", last)


def test_a_stage_that_fails_does_not_say_that_it_is_done(caplog, monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu")
    with (
        caplog.at_level(logging.INFO),
        pytest.raises(ZeroDivisionError),
        run.stage("warmup", "studio", 0),
    ):
        raise ZeroDivisionError
    assert len(caplog.messages) == 1


def given(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["stage", *words])


def test_a_commands_parameters_are_its_options_typed_and_all_required(monkeypatch, capsys):
    seen = []

    def main(scene: str, params_file: Path, count: int) -> None:
        """Do it."""
        seen.append((scene, params_file, count))

    given(monkeypatch, "--scene", "studio", "--params-file", "p.yaml", "--count", "3")
    run.command(main)
    assert seen == [("studio", Path("p.yaml"), 3)]
    given(monkeypatch, "--scene", "studio", "--count", "3")
    with pytest.raises(SystemExit) as stop:
        run.command(main)
    assert stop.value.code == 2
    assert "--params-file" in capsys.readouterr().err


@pytest.mark.parametrize("kind", [ConfigError, ArtifactError])
def test_a_callers_mistake_is_one_line_and_exit_code_1(monkeypatch, capsys, kind):
    def main() -> None:
        raise kind("params.yaml: warmup: unknown key 'x'")

    given(monkeypatch)
    with pytest.raises(SystemExit) as stop:
        run.command(main)
    assert stop.value.code == 1
    assert capsys.readouterr().err == f"{kind.__name__}: params.yaml: warmup: unknown key 'x'\n"


def test_what_a_caller_stops_is_one_line_and_exit_code_130(monkeypatch, capsys):
    def main() -> None:
        raise KeyboardInterrupt

    given(monkeypatch)
    with pytest.raises(SystemExit) as stop:
        run.command(main)
    assert stop.value.code == 130
    assert capsys.readouterr().err == ending.STOPPED_WORDS


def test_a_mistake_of_ours_keeps_its_traceback(monkeypatch):
    def main() -> None:
        raise KeyError("ours")

    given(monkeypatch)
    with pytest.raises(KeyError):
        run.command(main)


def test_a_fit_reports_every_tenth_of_its_way_and_its_end(caplog):
    report = run.fitting_progress("warmup studio", 25)
    with caplog.at_level(logging.INFO):
        for iteration in range(1, 26):
            report(iteration, {"l1": 0.5 / iteration, "mask": 0.25})
    assert len(caplog.messages) == 13  # every second of 25, and the last
    assert caplog.messages[-1] == "warmup studio 25/25: l1 0.0200 mask 0.2500"


def test_progress_passes_everything_through_and_is_silent_without_a_terminal(capfd):
    assert list(run.progress(range(5), "frames")) == [0, 1, 2, 3, 4]
    assert capfd.readouterr().err == ""


def test_peak_memory_is_the_systems_own_figure_in_megabytes():
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("no /proc/self/status on this system")
    (line,) = [line for line in status.read_text().splitlines() if line.startswith("VmHWM")]
    assert run.peak_memory_mb() == pytest.approx(int(line.split()[1]) / 1024, rel=0.02)
