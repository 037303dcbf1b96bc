import math

import pytest
import torch

from deblur_avatar.animation.bvh import read_bvh
from deblur_avatar.animation.retargeting import world_positions, world_rotations
from deblur_avatar.errors import ArtifactError

ARM = """HIERARCHY
ROOT Hips
{
\tOFFSET 0.0 90.0 0.0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
\tJOINT Left Arm
\t{
\t\tOFFSET 10.0 0.0 0.0
\t\tCHANNELS 3 Yrotation Zrotation Xrotation
\t\tEnd Site
\t\t{
\t\t\tOFFSET 5.0 0.0 0.0
\t\t}
\t}
}
MOTION
Frames: 2
Frame Time: 0.025
1 2 3 0 0 0 0 0 0
1 2 3 90 0 0 90 0 90
"""


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "motion.bvh"
        path.write_text(text)
        return path

    return write


def test_hierarchy_and_times_are_read(written):
    motion = read_bvh(written(ARM))
    assert motion.names == ("Hips", "Left Arm", "Left Arm_end")
    assert motion.parents == (-1, 0, 1)
    assert motion.fps == pytest.approx(40)
    assert motion.offsets.tolist() == [[0, 90, 0], [10, 0, 0], [5, 0, 0]]


def test_joints_stand_where_a_hand_calculation_puts_them(written):
    places = world_positions(read_bvh(written(ARM)))
    expected_still = torch.tensor([[1.0, 2, 3], [11, 2, 3], [16, 2, 3]]).double()
    # The root turns 90 degrees about z: its arm points along +y. The arm turns about its y by 90
    # degrees, x to -z, and then about its own x, which moves nothing along x.
    expected_turned = torch.tensor([[1.0, 2, 3], [1, 12, 3], [1, 12, -2]]).double()
    torch.testing.assert_close(places[0], expected_still)
    torch.testing.assert_close(places[1], expected_turned)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_the_first_channel_is_the_outermost_turn(written, order):
    from scipy.spatial.transform import Rotation

    angles = [20.0, -35.0, 50.0]
    names = " ".join(f"{axis}rotation" for axis in order)
    text = ARM.replace("Yrotation Zrotation Xrotation", names)
    text = text.replace("90 0 90\n", " ".join(map(str, angles)) + "\n")
    expected = Rotation.from_euler(order, angles, degrees=True).as_matrix()  # intrinsic
    read = read_bvh(written(text)).rotations[1, 1]
    torch.testing.assert_close(read, torch.from_numpy(expected))


def test_a_root_without_places_stays_at_its_offset(written):
    text = ARM.replace("CHANNELS 6 Xposition Yposition Zposition", "CHANNELS 3")
    text = text.replace("1 2 3 ", "")
    assert read_bvh(written(text)).positions[0][0].tolist() == [0, 90, 0]


def test_a_missing_place_channel_leaves_the_offset(written):
    text = ARM.replace("CHANNELS 6 Xposition Yposition Zposition", "CHANNELS 4 Yposition")
    text = text.replace("1 2 3 ", "2 ")
    assert read_bvh(written(text)).positions[0][0].tolist() == [0, 2, 0]


def test_place_channels_of_other_joints_are_in_their_parents_frames(written):
    channels = "CHANNELS 5 Zposition Xposition Yrotation Zrotation Xrotation"
    text = ARM.replace("CHANNELS 3 Yrotation Zrotation Xrotation", channels)
    text = text.replace("0 0 0 0 0 0\n", "0 0 0 7 8 0 0 0\n")
    text = text.replace("90 0 0 90 0 90\n", "90 0 0 7 8 90 0 90\n")
    changed, original = read_bvh(written(text)), read_bvh(written(ARM))
    assert set(original.positions) == {0}
    assert changed.positions[1].tolist() == [[8, 0, 7], [8, 0, 7]]  # y is the offset's
    assert changed.offsets.tolist() == original.offsets.tolist()
    # The root turns 90 degrees about z, as in the hand calculation above: x becomes y.
    expected = torch.tensor([[[1.0, 2, 3], [9, 2, 10]], [[1, 2, 3], [1, 10, 10]]]).double()
    torch.testing.assert_close(world_positions(changed)[:, :2], expected)
    torch.testing.assert_close(world_rotations(changed), world_rotations(original))


def test_windows_line_ends_blank_lines_and_tabs_do_not_matter(written):
    plain = read_bvh(written(ARM))
    odd = read_bvh(written(ARM.replace("\n", "\r\n").replace("MOTION", "\r\nMOTION\t")))
    torch.testing.assert_close(odd.rotations, plain.rotations)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("HIERARCHY", "SKELETON"), r"motion.bvh:1: wanted 'HIERARCHY', got 'SKELETON'"),
        (("ROOT Hips", "JOINT Hips"), r"motion.bvh:2: 'JOINT Hips' does not belong here"),
        (("ROOT Hips\n{", "ROOT Hips\n("), r"motion.bvh:3: wanted '\{', got '\('"),
        (("OFFSET 0.0 90.0", "OFFSET 0.0 high"), r"motion.bvh:4: could not convert .* 'high'"),
        (("OFFSET 10.0 0.0 0.0", "OFFSET 10.0 0.0"), r"motion.bvh:8: wanted 3 finite numbers"),
        (("CHANNELS 3 Y", "CHANNELS 4 Y"), r"motion.bvh:9: CHANNELS must give a number"),
        (("Yrotation Zrotation Xr", "Yrotation Yrotation Xr"), r"motion.bvh:9: CHANNELS must"),
        (("Yrotation Zrotation Xr", "Wrotation Zrotation Xr"), r":9: .* got 3 Wrotation Zrot"),
        (("\t\tOFFSET 10.0 0.0 0.0\n", ""), r"motion.bvh:13: joint Left Arm has no OFFSET"),
        (("}\nMOTION", "MOTION"), r"motion.bvh:15: 'MOTION' does not belong here"),
        (("Frames: 2", "Frames: two"), r"Frames must be a positive number, got 'two'"),
        (("Frames: 2", "Frames: 0"), r"Frames must be a positive number, got '0'"),
        (("Frames: 2", "Frames: 3"), r"Frames says 3, the file ends after 2"),
        (("Frames: 2", "Frames: 1"), r"motion.bvh:20: Frames says 1, but 1 follows"),
        (("0.025", "0"), r"motion.bvh:18: Frame Time must be positive, got 0"),
        (("0.025", "-inf"), r"motion.bvh:18: wanted 1 finite numbers"),
        (("90 0 0 90 0 90", "90 0 0 90 0"), r"motion.bvh:20: wanted 9 finite .* \(8 of them\)"),
        (("90 0 0 90 0 90", "90 0 0 90 0 nan"), r"motion.bvh:20: wanted 9 finite numbers"),
        (("MOTION\n", ""), r"motion.bvh:16: 'Frames: 2' does not belong here"),
    ],
)
def test_a_broken_file_is_named_with_its_line(written, change, message):
    assert change[0] in ARM
    with pytest.raises(ArtifactError, match=message):
        read_bvh(written(ARM.replace(*change)))


@pytest.mark.parametrize("length", [0, 9, 60, 200, 270, 300])
def test_a_truncated_file_is_refused(written, length):
    with pytest.raises(ArtifactError, match=r"motion\.bvh"):
        read_bvh(written(ARM[:length]))


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(ArtifactError, match="cannot read .*absent.bvh"):
        read_bvh(tmp_path / "absent.bvh")
    (tmp_path / "binary.bvh").write_bytes(bytes(range(256)))
    with pytest.raises(ArtifactError, match="cannot read .*binary.bvh"):
        read_bvh(tmp_path / "binary.bvh")


def test_angles_are_in_degrees(written):
    turned = read_bvh(written(ARM)).rotations[1, 0]
    assert math.degrees(math.acos((float(turned.trace()) - 1) / 2)) == pytest.approx(90)
