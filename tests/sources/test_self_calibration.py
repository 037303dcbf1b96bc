import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
import torch

from deblur_avatar.sources import self_calibration
from deblur_avatar.sources.self_calibration import _agreed, _answer, calibrate_focal

WIDTH, HEIGHT, FOCAL, FRAMES = 320, 240, 380.0, 12


def painted(seed: int) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    return cv2.resize(coarse, (512, 512), interpolation=cv2.INTER_CUBIC)


# Corner and two edges of a back wall, a floor and a side wall; metres, OpenCV's axes.
PLANES = [
    (np.array(corner), np.array(right), np.array(down), painted(seed))
    for seed, (corner, right, down) in enumerate(
        [
            ((-6.0, -4, 8), (12.0, 0, 0), (0.0, 6, 0)),
            ((-6.0, 2, 2), (12.0, 0, 0), (0.0, 0, 6)),
            ((-3.0, -4, 8), (0.0, 0, -6), (0.0, 6, 0)),
        ]
    )
]


def seen(rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for corner, right, down, texture in PLANES:
        place = np.stack([right / 512, down / 512, corner - centre], axis=1)
        homography = K @ rotation @ place
        drawn = cv2.warpPerspective(texture, homography, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
        filled = cv2.warpPerspective(np.full_like(texture, 255), homography, (WIDTH, HEIGHT))
        image = np.where(filled > 0, drawn, image)
    return image


def filmed(walks: bool) -> tuple[torch.Tensor, torch.Tensor]:
    frames, mattes = [], []
    for index in range(FRAMES):
        way = index if walks else 0
        turn = 0.5 * (way / (FRAMES - 1) - 0.5)
        rotation = cv2.Rodrigues(np.array([0, -0.9 * turn, 0.05 * np.sin(way)]))[0]
        side = np.array([5 * turn, -0.6 + 0.3 * np.sin(way / 3), 1.2 * np.cos(turn) - 1.2])
        frame = seen(rotation, side)
        frame[100:200, 140:180] = 20 * index  # the person, who is not to be matched
        matte = np.zeros((HEIGHT, WIDTH), np.uint8)
        matte[100:200, 140:180] = 255
        frames.append(frame)
        mattes.append(matte)
    return torch.from_numpy(np.stack(frames)), torch.from_numpy(np.stack(mattes))


def turned_in_place() -> tuple[torch.Tensor, torch.Tensor]:
    """A camera that looks about from where it stands."""
    turns = [cv2.Rodrigues(np.array([0.01 * i, -0.02 * i, 0.01 * i]))[0] for i in range(FRAMES)]
    frames = np.stack([seen(turn, np.array([0.0, -0.6, 0.0])) for turn in turns])
    return torch.from_numpy(frames), torch.zeros(frames.shape[:3], dtype=torch.uint8)


def test_a_walking_camera_s_focal_length_is_found():
    focal, how = calibrate_focal(*filmed(walks=True))
    assert focal == pytest.approx(FOCAL, rel=0.02)
    assert "12 of 12 frames placed" in how


@pytest.mark.parametrize("filmed_in_place", [filmed(walks=False), turned_in_place()])
def test_a_camera_in_one_place_gives_no_answer_and_is_not_looked_for(filmed_in_place, caplog):
    with caplog.at_level("INFO"):
        focal, how = calibrate_focal(*filmed_in_place)
    assert focal is None
    assert "turned or drifted in one place" in how
    assert "looked for" not in caplog.text


def test_the_same_frames_give_the_same_bits():
    assert calibrate_focal(*filmed(walks=True)) == calibrate_focal(*filmed(walks=True))


def test_what_several_threads_would_change_runs_on_one(monkeypatch):
    """Two runs agree by chance: several threads find other matches in 7 of 100."""
    threads: dict[str, int] = {}

    def counted(name: str, options: str) -> None:
        step = getattr(pycolmap, name)

        def run(*given: Any, **named: Any) -> Any:
            threads[name] = named[options].num_threads
            return step(*given, **named)

        monkeypatch.setattr(pycolmap, name, run)

    counted("match_sequential", "matching_options")
    counted("geometric_verification", "verifier_options")
    counted("incremental_mapping", "options")
    calibrate_focal(*filmed(walks=True))
    assert threads == dict.fromkeys(threads, 1)
    assert len(threads) == 3


def test_cameras_that_fit_badly_are_no_answer():
    way = SimpleNamespace(
        num_reg_images=lambda: 40,
        compute_mean_reprojection_error=lambda: 0.86,
        cameras={1: SimpleNamespace(mean_focal_length=lambda: 485.0)},
    )  # of a street filmed through a rolling shutter, whose true focal length is 739
    focal, why = _answer({0: way}, 40, 960)
    assert focal is None
    assert "not to be believed: 40 of 40 frames placed, error 0.86 px, focal 485 px" in why
    way.compute_mean_reprojection_error = lambda: 0.4
    assert _answer({0: way}, 40, 960)[0] == 485.0


def test_what_ends_one_look_ends_the_other(monkeypatch, tmp_path):
    begun, ended = threading.Event(), threading.Event()

    def look(folder: Path, stop: Any, seed: int) -> None:
        if seed == 1:
            begun.wait(20)
            raise KeyboardInterrupt
        begun.set()
        deadline = time.monotonic() + 20
        while not stop.is_cancelled and time.monotonic() < deadline:
            time.sleep(0.01)
        if stop.is_cancelled:
            ended.set()

    monkeypatch.setattr(self_calibration, "_look", look)
    with pytest.raises(KeyboardInterrupt):
        self_calibration._looks(tmp_path)
    assert ended.is_set()


def test_looks_that_agree_give_their_geometric_mean():
    near = [(690.0, "self-calibrated: a"), (700.0, "self-calibrated: b")]
    focal, how = _agreed(near)
    assert focal == pytest.approx((690.0 * 700.0) ** 0.5)
    assert how == "self-calibrated: a, focal 695 px (looks: 690 and 700)"


def test_what_two_looks_do_not_agree_on_is_no_answer():
    near, far = (690.0, "self-calibrated: a"), (513.0, "self-calibrated: b")
    for order in ([near, far], [far, near]):
        focal, why = _agreed(order)
        assert focal is None
        assert "does not agree with itself" in why
        assert "690" in why
        assert "513" in why
    assert _agreed([near, (None, "no way")]) == (None, "no way")


def test_each_step_says_that_it_has_begun(caplog):
    with caplog.at_level("INFO"):
        calibrate_focal(*filmed(walks=True))
    steps = [line.message for line in caplog.records if "self-calibration: " in line.message]
    assert [step.split(": ")[1].split()[0] for step in steps[:3]] == ["features", "matches", "the"]
