from pathlib import Path

import av
import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.video_writing import X264_VARIABLE, write_video

pytestmark = pytest.mark.portable


def pictures(count: int = 12, height: int = 33, width: int = 47) -> list[np.ndarray]:
    """A red square on a blue ramp; it moves 2 pixels a picture."""
    stack = np.zeros((count, height, width, 3), np.uint8)
    stack[..., 2] = np.linspace(40, 200, width)
    for index, picture in enumerate(stack):
        picture[10:24, 2 * index : 2 * index + 14] = (220, 30, 30)
    return list(stack)


def decode(path: Path) -> tuple[av.VideoStream, list[np.ndarray]]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return stream, [x.to_ndarray(format="rgb24") for x in container.decode(video=0)]


def test_a_video_shows_the_pictures_it_was_made_of(tmp_path):
    assert write_video(tmp_path / "walk.mp4", iter(pictures()), 30.0) == 12
    _, shown = decode(tmp_path / "walk.mp4")
    assert len(shown) == 12
    shown = np.stack(shown)[:, :33, :47].astype(int)
    errors = [[np.abs(one - other).mean() for other in pictures()] for one in shown]
    # Colour is stored at half the resolution, so that the square's edges differ: the mean error is
    # 2.5 with one kind of CPU and 2.6 with another, and 4.8 from the next picture.
    for index, row in enumerate(errors):
        assert all(row[index] < 0.75 * other for i, other in enumerate(row) if i != index)
    # Away from edges, 4 of 255 are lost. Another matrix (BT.601's) is 17 off, a wrong range 15.
    inside = [x[13:21, 2 * i + 3 : 2 * i + 11].mean((0, 1)) for i, x in enumerate(shown)]
    assert np.abs(np.mean(inside, axis=0) - (220, 30, 30)).max() < 8


def test_the_encoder_can_be_told_more(tmp_path, monkeypatch):
    write_video(tmp_path / "walk.mp4", pictures(), 30.0)
    monkeypatch.setenv(X264_VARIABLE, "qp=51")  # as coarse as it gets
    write_video(tmp_path / "coarse.mp4", pictures(), 30.0)
    assert (tmp_path / "coarse.mp4").stat().st_size < (tmp_path / "walk.mp4").stat().st_size


def test_any_browser_can_play_it(tmp_path):
    write_video(tmp_path / "walk.mp4", pictures(), 59.94)
    stream, _ = decode(tmp_path / "walk.mp4")
    assert stream.codec_context.name == "h264"
    assert stream.codec_context.pix_fmt == "yuv420p"
    assert float(stream.average_rate) == pytest.approx(59.94)
    assert (stream.width, stream.height) == (48, 34)
    content = (tmp_path / "walk.mp4").read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # starts before all of it is there


def test_equal_pictures_give_equal_bytes(tmp_path):
    for name in ("one.mp4", "two.mp4"):
        write_video(tmp_path / name, pictures(), 30.0)
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "two.mp4").read_bytes()


def test_memory_that_others_used_leaves_no_trace_in_a_video(tmp_path):
    """With B pictures as references x264 did not write the same bytes every time."""
    ramp = np.add.outer(np.arange(192), np.arange(192)).astype(np.uint8)
    waves = [np.repeat((ramp + np.uint8(3 * index))[..., None], 3, 2) for index in range(40)]
    generator = np.random.default_rng(0)
    found = set()
    for _ in range(16):
        used = [generator.integers(0, 255, size, np.uint8)
                for size in generator.integers(1000, 400_000, 50)]  # fmt: skip
        write_video(tmp_path / "waves.mp4", waves, 30.0)
        found.add((tmp_path / "waves.mp4").read_bytes())
        del used
    assert len(found) == 1


def test_a_video_that_fails_leaves_the_old_one_and_no_scrap(tmp_path):
    write_video(tmp_path / "walk.mp4", pictures(), 30.0)
    before = (tmp_path / "walk.mp4").read_bytes()
    with pytest.raises(ValueError, match="picture 13 is 20 x 10 pixels, those before are 48 x 34"):
        write_video(tmp_path / "walk.mp4", [*pictures(), *pictures(1, 10, 20)], 30.0)
    with pytest.raises(ValueError, match="at least one picture"):
        write_video(tmp_path / "walk.mp4", [], 30.0)
    assert (tmp_path / "walk.mp4").read_bytes() == before
    assert [x.name for x in tmp_path.iterdir()] == ["walk.mp4"]


def test_a_disk_that_refuses_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ArtifactError, match=r"cannot write video .*file/walk.mp4"):
        write_video(tmp_path / "file" / "walk.mp4", pictures(), 30.0)
