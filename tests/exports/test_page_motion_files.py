"""Motion files opened on the page move the avatar as Python would, in a real browser."""

import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.config.reading import parse
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.exports.rigged import rigged_avatar
from deblur_avatar.exports.shown_motion import shown_motions
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from tests.animation.skeleton_text import bvh
from tests.animation.test_retargeting import (
    MIXAMO,
    MOCAP,
    acted,
    as_rig,
    odd_frames,
    under_a_reference,
)
from tests.exports.browser import opened

TOLERANCE = 1e-5  # metres, and of a rotation's matrix
Z_UP = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).double()


@pytest.fixture
def run(rough, fitted_run):
    return fitted_run(rough())


@pytest.fixture
def file(request, run, body, tmp_path):
    """A file of each kind that can be opened."""
    kind = request.param
    if kind in ("cmu_01_01_fairmotion", "rokoko_jesse_dance"):
        if not (MOCAP / f"{kind}.bvh").is_file():
            pytest.skip(f"no {kind}.bvh in {MOCAP}")
        lines = (MOCAP / f"{kind}.bvh").read_text().splitlines()
        start = next(i for i, line in enumerate(lines) if line.startswith("Frames"))
        short = [*lines[:start], "Frames: 60", *lines[start + 1 : start + 62]]
        path = tmp_path / "dance.bvh"
        path.write_text("\n".join(short))
        return path
    if kind in ("mixamo", "odd", "reference", "side_last"):
        path = tmp_path / f"{kind}.bvh"
        odd = kind == "odd"
        pose, transl = acted(frames=25)
        plain = [side_last(name) if kind == "side_last" else name for name in MIXAMO]
        rig = as_rig(
            body, pose, transl, frames_of_joints=odd_frames(int(odd)), unit=100.0,
            turn=Z_UP if odd else None, names=tuple(f"mixamorig:{name}" for name in plain),
        )  # fmt: skip
        path.write_text(bvh(under_a_reference(rig) if kind == "reference" else rig))
        return path
    suffix = ".bvh" if kind == "own_bvh" else ".npz"
    path = tmp_path / f"own{suffix}"
    options = {"format": "npz"}
    if suffix == ".bvh":
        options = {"format": "bvh", "motion": "own", "fps": 30.0, "seconds": 1.0}
    parse(ExportParams, options, "export").export(run, path)
    if kind == "packed_npz":
        with np.load(path) as content:
            np.savez_compressed(path, **content)
    return path


def side_last(name):
    """`Leg_L` for `LeftLeg`."""
    side = next((side for side in ("Left", "Right") if name.startswith(side)), None)
    return name if side is None else f"{name.removeprefix(side)}_{side[0]}"


def choose(page, path):
    page.get_by_label("Motion file").set_input_files(path)
    page.get_by_text(path.name).wait_for()


KINDS = [
    "mixamo", "odd", "reference", "side_last", "own_bvh", "own_npz", "packed_npz",
    "cmu_01_01_fairmotion", "rokoko_jesse_dance",
]  # fmt: skip


@pytest.mark.parametrize("file", KINDS, indirect=True)
def test_joints_are_where_and_turned_as_python_has_them(page, page_file, run, file):
    opened(page, page_file)
    choose(page, file)
    shown = page.evaluate("structuredClone(window.page.state)")
    assert shown["motion"] == f"file:{file.stem}"
    times = page.evaluate("[...window.page.motion.times]")
    fps = (len(times) - 1) / times[-1]
    (motion,) = shown_motions(run, [str(file)], fps, times[-1] + 1)
    assert len(motion.times) == len(times) >= 5
    poses = motion.poses
    model = rigged_avatar(run).model
    ours = model.transforms(axis_angle_to_matrix(poses.axis_angle), poses.transl)[
        ..., :3, :
    ].numpy()
    theirs = [page.evaluate("(s) => window.page.transforms({seconds: s})", s) for s in times]
    assert np.abs(np.reshape(theirs, ours.shape) - ours).max() < TOLERANCE
    assert np.ptp(ours[..., 3], axis=0).max() > 0.02  # it does move


def test_a_file_that_is_dropped_is_opened_and_moves_both_avatars(page, page_of_two, body):
    opened(page, page_of_two)
    pose, transl = acted(frames=12)
    text = bvh(as_rig(body, pose, transl, frames_of_joints=odd_frames(0)))
    page.evaluate(
        """(text) => {
          const dataTransfer = new DataTransfer();
          dataTransfer.items.add(new File([text], "my dance.bvh"));
          for (const kind of ["dragover", "drop"]) {
            document.querySelector("canvas").dispatchEvent(
              new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));
          }
        }""",
        text,
    )
    page.get_by_text("Opened my dance.bvh: 12 frames, 0.4 s.").wait_for()
    chooser = page.get_by_role("combobox", name="Motion", exact=True)
    assert chooser.locator("option:checked").inner_text() == "my dance"
    asked = "(a) => [0, 0.3].map((seconds) => window.page.transforms({avatar: a, seconds}))"
    first, second = (np.array(page.evaluate(asked, a)) for a in (0, 1))
    assert np.abs(first[1] - first[0]).max() > 0.05
    np.testing.assert_allclose(first, second, atol=1e-3)
    chooser.select_option("As filmed")
    assert page.evaluate("window.page.state.motion") == "own"


def test_joints_whose_places_are_not_read_are_named(page, page_file, body, tmp_path):
    rig = as_rig(body, *acted(frames=4), frames_of_joints=odd_frames(0))
    places = rig.offsets[16] + torch.linspace(0, 0.2, 4).double()[:, None]
    (tmp_path / "loose.bvh").write_text(bvh(dataclasses.replace(
        rig, positions=rig.positions | {16: places},
    )))  # fmt: skip
    opened(page, page_file)
    choose(page, tmp_path / "loose.bvh")
    said = page.locator("#said").inner_text()
    assert "Opened loose.bvh: 4 frames" in said
    assert said.endswith("Positions of LeftArm change, which is not read.")


BROKEN = {
    "notes.txt": (b"hello", "a motion is a .bvh file or an AMASS .npz, this is .txt"),
    "short.bvh": (b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0", "the file ends where"),
    "odd.bvh": (b"HIERARCHY\nROOT a\n{\nOFFSET 0 0\n}", 'line 4: wanted 3 numbers, got "0 0"'),
    "other.bvh": (
        b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n}\nMOTION\nFrames: 1\n"
        b"Frame Time: 0.1\n0\n",
        "the skeleton has no joint for pelvis, head",
    ),
    "text.npz": (b"no archive", "it is no archive of numpy's"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_cannot_be_opened_is_said_and_changes_nothing(page, page_file, tmp_path, name):
    content, message = BROKEN[name]
    opened(page, page_file)
    before = page.evaluate("structuredClone(window.page.state)")
    (tmp_path / name).write_bytes(content)
    choose(page, tmp_path / name)
    said = page.locator("#said").inner_text()
    assert said.startswith(f"{name} cannot be opened: ")
    assert message in said
    assert page.evaluate("structuredClone(window.page.state)") == before
    assert page.get_by_role("combobox", name="Motion", exact=True).locator("option").count() == 2


def test_other_arrays_are_named(page, page_file, tmp_path):
    opened(page, page_file)
    np.savez(tmp_path / "a.npz", poses=np.zeros((3, 60)), trans=np.zeros((3, 3)))
    choose(page, tmp_path / "a.npz")
    assert "found poses, trans" in page.locator("#said").inner_text()
    rate = np.float64(30)
    np.savez(tmp_path / "b.npz", poses=np.zeros((3, 60)), trans=np.zeros((3, 3)),
             mocap_framerate=rate)  # fmt: skip
    choose(page, tmp_path / "b.npz")
    assert "poses must be frames of 66, 72" in page.locator("#said").inner_text()
