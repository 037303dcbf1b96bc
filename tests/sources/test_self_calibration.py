import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.sources.self_calibration import _agreed, calibrate_focal

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


def test_a_walking_camera_s_focal_length_is_found():
    focal, how = calibrate_focal(*filmed(walks=True))
    assert focal == pytest.approx(FOCAL, rel=0.02)
    assert "12 of 12 frames placed" in how


def test_a_still_camera_gives_no_answer():
    focal, how = calibrate_focal(*filmed(walks=False))
    assert focal is None
    assert "no way of the camera" in how or "not to be believed" in how


def test_what_two_seeds_do_not_agree_on_is_no_answer():
    near, far = (690.0, "self-calibrated: a"), (513.0, "self-calibrated: b")
    assert _agreed([near, (700.0, "self-calibrated: c")]) == near
    for order in ([near, far], [far, near]):
        focal, why = _agreed(order)
        assert focal is None
        assert "does not agree with itself" in why
        assert "690" in why
        assert "513" in why
    assert _agreed([near, (None, "no way")]) == (None, "no way")
