from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
import torch

from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.sources.video_files import Video, read_video
from deblur_avatar.sources.video_pictures import srgb_of_hdr

WIDTH, HEIGHT, COUNT, FPS = 96, 64, 6, 25
BT709, BT2020, HLG, PQ = 1, 9, 18, 16
COLOURS = [
    (200, 30, 30),
    (30, 200, 30),
    (30, 30, 200),
    (90, 90, 90),
    (230, 230, 230),
    (240, 120, 20),
]
TO_BT2020 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])


def stripes() -> np.ndarray:
    return np.repeat(np.array(COLOURS, np.uint8)[None], WIDTH // 6, axis=1).repeat(HEIGHT, 0)


def light_of(srgb: np.ndarray) -> np.ndarray:
    return np.asarray(srgb_to_linear(torch.from_numpy(srgb / 255.0)))


def hlg_of(light: np.ndarray) -> np.ndarray:
    """BT.2100's OETF; white is 75 % of the signal."""
    scene = light * 0.264962
    high = 0.17883277 * np.log((12 * scene - 0.28466892).clip(1e-9)) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), high)


def pq_of(light: np.ndarray) -> np.ndarray:
    """SMPTE ST 2084; white is 203 cd/m2."""
    power = (light * 203 / 10000) ** (2610 / 16384)
    return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375


def write(
    path: Path,
    pictures: list[np.ndarray],
    set_up: Callable[[av.VideoStream], None] = lambda stream: None,
    options: dict[str, str] | None = None,
    hdr: int = 0,
) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=FPS, options={"crf": "1", **(options or {})})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p10le" if hdr else "yuv420p"
        context, space = stream.codec_context, BT2020 if hdr else BT709
        context.colorspace = context.color_primaries = space
        context.color_range, context.color_trc = 1, hdr or BT709
        set_up(stream)
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(picture, format="rgb48le" if hdr else "rgb24")
            frame = frame.reformat(
                format=stream.pix_fmt,
                dst_colorspace=space,
                dst_color_range=1,
                interpolation="POINT",
            )
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def read(path: Path) -> Video:
    return read_video(path, 0, None, 1000)


@pytest.mark.parametrize(("transfer", "signal"), [(HLG, hlg_of), (PQ, pq_of)], ids=["HLG", "PQ"])
def test_high_dynamic_range_is_the_srgb_that_was_filmed(
    transfer: int,
    signal: Callable[[np.ndarray], np.ndarray],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
):
    wide = light_of(stripes()) @ TO_BT2020.T
    picture = (signal(wide) * 65535).round().astype(np.uint16)
    video = read(write(tmp_path / "phone.mp4", [picture] * 3, hdr=transfer))
    middles = video.frames[0, HEIGHT // 2, 8::16].numpy().astype(int)
    assert np.abs(middles - COLOURS).max() <= 8
    assert caplog.text.count("brought to sRGB") == 1


def test_white_and_mid_grey_are_where_the_standards_have_them():
    def grey(signal: float, transfer: str) -> int:
        picture = np.full((1, 1, 3), round(signal * 65535), np.uint16)
        return int(srgb_of_hdr(picture, transfer, wide=True)[0, 0, 1])

    assert grey(0.75, "HLG") == 255 == grey(0.9, "HLG")
    assert grey(0.5, "HLG") == 152  # 1/12 of the range, 0.3145 of white
    assert grey(0.5807, "PQ") == 255 == grey(0.8, "PQ")
    assert grey(0.5081, "PQ") == 186  # 100 of 203 cd/m2
    assert grey(0.0, "HLG") == 0 == grey(0.0, "PQ")


def test_colours_of_narrow_primaries_stay_as_they_are():
    picture = np.array([[[round(float(hlg_of(np.array(0.5))) * 65535), 0, 0]]], np.uint16)
    assert srgb_of_hdr(picture, "HLG", wide=False)[0, 0].tolist() == [188, 0, 0]
    assert srgb_of_hdr(picture, "HLG", wide=True)[0, 0, 0] > 230


def woven(index: int) -> np.ndarray:
    """A bar that moves on while the second field, which is the top one, is taken."""
    picture = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    for row in range(HEIGHT):
        left = 10 + 8 * index + 4 * ((row + 1) % 2)
        picture[row, left : left + 12] = 220
    return picture


def test_of_interlaced_frames_one_field_is_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    options = {"flags": "+ilme+ildct", "x264-params": "bff=1"}
    video = read(write(tmp_path / "tape.mp4", list(map(woven, range(COUNT))), options=options))
    assert len(video.frames) == COUNT
    assert video.timestamps.tolist() == pytest.approx([i / FPS for i in range(COUNT)], abs=1e-3)
    rows = video.frames[2, 8:-8, :, 1].float()
    assert (rows[1:] - rows[:-1]).abs().mean() < 3  # woven rows differ by 15
    assert rows[:, 26 + 1 : 26 + 11].mean() > 190  # where the first field was, not the second
    assert rows[:, 26 + 13 :].mean() < 60
    assert caplog.text.count("two instants in one") == 1


def test_pixels_wider_than_high_are_made_square(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    def wide(stream: av.VideoStream) -> None:
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)

    video = read(write(tmp_path / "tape.mp4", [stripes()] * 3, wide))
    assert video.recorded_size == (WIDTH * 4 // 3, HEIGHT)
    assert video.frames.shape[1:3] == (HEIGHT, WIDTH * 4 // 3)
    assert "pixels of 4:3 are made square" in caplog.text


def test_an_ordinary_file_is_read_without_a_word(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    video = read(write(tmp_path / "plain.mp4", [stripes()] * 3))
    middles = video.frames[0, HEIGHT // 2, 8::16].numpy().astype(int)
    assert np.abs(middles - COLOURS).max() <= 4
    assert caplog.text == ""
