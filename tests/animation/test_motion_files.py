import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from deblur_avatar.animation.aist import read_aist
from deblur_avatar.animation.amass import read_amass
from deblur_avatar.animation.builtin_motions import BUILTIN_MOTIONS, builtin_motion
from deblur_avatar.animation.motion_files import read_motion
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.bodies.posed_body import posed_joints
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from tests.animation.skeleton_text import bvh
from tests.animation.test_retargeting import acted, as_rig, odd_frames, under_a_reference

INDEX = {name: index for index, name in enumerate(SMPL_JOINT_NAMES)}


def amass(frames=5, width=156, rate=120.0, **changes):
    """A sequence as AMASS writes it: someone upright in a world with +Z up, walking along +Y."""
    poses = np.zeros((frames, width))
    poses[:, 0] = np.pi / 2  # SMPL's +Y to the world's +Z
    poses[:, 3:66] = np.random.default_rng(0).normal(size=(frames, 63)) * 0.2
    poses[:, 66:] = 1.0
    trans = np.stack([np.zeros(frames), np.arange(frames) * 0.1, np.full(frames, 0.9)], 1)
    content = {
        "poses": poses, "trans": trans, "betas": np.zeros(16), "mocap_framerate": np.array(rate),
        "gender": np.array("female"), "dmpls": np.zeros((frames, 8)),
    }  # fmt: skip
    return {k: v for k, v in (content | changes).items() if v is not None}


def saved(tmp_path, **content):
    path = tmp_path / "motion.npz"
    np.savez(path, **content)
    return path


@pytest.mark.parametrize("width", [66, 72, 156, 165])
def test_amass_poses_stand_upright_with_plus_y_up(tmp_path, width):
    content = amass(width=width)
    motion = read_amass(saved(tmp_path, **content))
    assert motion.fps == 120
    turned = axis_angle_to_matrix(motion.global_orient)
    torch.testing.assert_close(turned, torch.eye(3).expand(5, 3, 3), atol=1e-6, rtol=0)
    expected = torch.tensor([[0.0, 0.9, -0.1 * i] for i in range(5)])  # +Y becomes -Z
    torch.testing.assert_close(motion.transl, expected, atol=1e-6, rtol=0)
    body = torch.from_numpy(content["poses"][:, 3:66]).float().reshape(5, 21, 3)
    torch.testing.assert_close(motion.body_pose[:, :21], body)
    assert motion.body_pose[:, 21:].abs().max() == 0  # hands


def test_amass_files_of_smplx_name_their_rate_otherwise(tmp_path):
    content = amass(width=165, mocap_framerate=None)
    assert read_amass(saved(tmp_path, mocap_frame_rate=np.array(30.0), **content)).fps == 30


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": None}, "wanted poses, trans, mocap_framerate, got trans, mocap_framerate"),
        ({"mocap_framerate": None}, "wanted poses, trans, mocap_framerate, got poses, trans"),
        ({"poses": np.zeros((5, 63))}, r"poses must be \[F, 66 .*got \(5, 63\)"),
        ({"trans": np.zeros((4, 3))}, r"trans \[F, 3\], got \(5, 156\) and \(4, 3\)"),
        ({"trans": np.full((5, 3), np.nan)}, "must be finite numbers"),
        ({"trans": np.full((5, 3), "x")}, "must be finite numbers"),
        ({"mocap_framerate": np.array(0.0)}, "positive mocap_framerate, got 0.0"),
        ({"poses": np.zeros((0, 156)), "trans": np.zeros((0, 3))}, "wanted frames"),
        ({"poses": np.array([None])}, "not a readable .npz file"),
    ],
)
def test_a_wrong_amass_file_says_what_is_wrong(tmp_path, changes, message):
    with pytest.raises(ArtifactError, match=message):
        read_amass(saved(tmp_path, **amass(**changes)))


def test_a_damaged_or_missing_amass_file_is_refused(tmp_path):
    path = saved(tmp_path, **amass())
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(ArtifactError, match="not a readable .npz file"):
        read_amass(path)
    path.write_text("not an archive")
    with pytest.raises(ArtifactError, match="not a readable .npz file"):
        read_amass(path)
    with pytest.raises(ArtifactError, match="cannot read .*absent.npz"):
        read_amass(tmp_path / "absent.npz")


def aist(frames=4, **changes):
    poses = np.random.default_rng(1).normal(size=(frames, 72)) * 0.2
    trans = np.tile([[10.0, 170.0, 300.0]], (frames, 1))
    return {
        "smpl_poses": poses, "smpl_trans": trans, "smpl_scaling": np.array([94.0]),
        "smpl_loss": 0.1,
    } | changes  # fmt: skip


def pickled(tmp_path, content):
    path = tmp_path / "dance.pkl"
    path.write_bytes(pickle.dumps(content))
    return path


def test_aist_dances_come_in_metres_at_sixty_frames(tmp_path):
    content = aist()
    motion = read_aist(pickled(tmp_path, content))
    assert motion.fps == 60
    torch.testing.assert_close(motion.transl[0], torch.tensor([10.0, 170.0, 300.0]) / 94)
    pose = torch.from_numpy(content["smpl_poses"]).float().reshape(4, 24, 3)
    torch.testing.assert_close(motion.global_orient, pose[:, 0])
    torch.testing.assert_close(motion.body_pose, pose[:, 1:])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"poses": 1}, "wanted smpl_poses, smpl_trans, smpl_scaling, got poses"),
        (aist(smpl_poses=np.zeros((4, 69))), r"smpl_poses must be \[F, 72\].*got \(4, 69\)"),
        (aist(smpl_trans=np.zeros((3, 3))), r"got \(4, 72\) and \(3, 3\)"),
        (aist(smpl_scaling=np.array([0.0])), "a positive smpl_scaling"),
        (aist(smpl_trans=np.full((4, 3), np.inf)), "wanted finite numbers"),
        (aist(smpl_poses="dance"), "could not convert string"),
    ],
)
def test_a_wrong_aist_file_says_what_is_wrong(tmp_path, content, message):
    with pytest.raises(ArtifactError, match=message):
        read_aist(pickled(tmp_path, content))


def test_an_aist_file_that_runs_a_program_is_refused(tmp_path):
    path = tmp_path / "dance.pkl"
    path.write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(ArtifactError, match=r"wants to run os\.system"):
        read_aist(path)


@pytest.mark.parametrize("name", BUILTIN_MOTIONS)
def test_built_in_motions_are_functions_of_time(name):
    whole = builtin_motion(name, fps=60.0, start=0.0, seconds=2.0)
    part = builtin_motion(name, fps=30.0, start=0.5, seconds=1.0)
    torch.testing.assert_close(part.body_pose, whole.body_pose[30:91:2])
    torch.testing.assert_close(part.transl, whole.transl[30:91:2])
    assert len(whole.transl) == 121


@pytest.mark.parametrize("name", BUILTIN_MOTIONS)
def test_built_in_motions_are_smooth(name):
    motion = builtin_motion(name, fps=240.0, start=0.0, seconds=3.0)
    assert motion.body_pose.diff(dim=0).abs().max() < 0.05
    assert motion.transl.diff(dim=0).abs().max() < 0.01


def test_jumping_jacks_mirror_left_and_right_and_keep_feet_near_the_ground(body):
    motion = builtin_motion("jumping_jacks", fps=30.0, start=0.0, seconds=1.1)
    places = posed_joints(
        body, torch.zeros(2), motion.global_orient, motion.body_pose, motion.transl
    )
    untwisted = motion.body_pose.clone()
    untwisted[:, [INDEX[n] - 1 for n in ("spine1", "spine2", "spine3", "neck")]] = 0
    plain = posed_joints(body, torch.zeros(2), motion.global_orient, untwisted, motion.transl)
    for name in ("wrist", "ankle", "knee", "elbow"):
        left, right = plain[:, INDEX[f"left_{name}"]], plain[:, INDEX[f"right_{name}"]]
        torch.testing.assert_close(left * torch.tensor([-1.0, 1, 1]), right, atol=1e-4, rtol=0)
    hands = places[:, INDEX["left_wrist"], 1]
    assert hands.max() > places[:, INDEX["head"], 1].max()
    assert hands.min() < places[0, INDEX["spine2"], 1]
    landed = places[[0, -1, len(places) // 2], INDEX["left_ankle"], 1]
    assert landed.max() - landed.min() < 0.06


def test_a_motion_is_read_by_its_name_at_the_rate_asked_for(body, tmp_path):
    options = {"fps": 30.0, "start": 0.0, "seconds": 0.5}
    built = read_motion("builtin:jumping_jacks", body, torch.zeros(2), **options)
    assert len(built.transl) == 16
    captured = read_motion(
        str(saved(tmp_path, **amass(frames=31, rate=60.0))), body, torch.zeros(2), **options
    )
    assert len(captured.transl) == 16
    assert captured.fps == 30
    danced = read_motion(str(pickled(tmp_path, aist(frames=61))), body, torch.zeros(2), **options)
    assert len(danced.transl) == 16


def test_an_unknown_or_missing_motion_names_the_choices(body, tmp_path):
    options = {"fps": 30.0, "start": 0.0, "seconds": 0.5}
    with pytest.raises(ConfigError, match="no built-in motion 'moonwalk'; there are jumping_jacks"):
        read_motion("builtin:moonwalk", body, torch.zeros(2), **options)
    with pytest.raises(
        ConfigError, match=r"no motion file absent\.bvh; set .* builtin:jumping_jac"
    ):
        read_motion("absent.bvh", body, torch.zeros(2), **options)
    (tmp_path / "dance.fbx").write_text("")
    with pytest.raises(ConfigError, match=r"is a \.bvh, \.npz or \.pkl file, got '\.fbx'"):
        read_motion(str(tmp_path / "dance.fbx"), body, torch.zeros(2), **options)
    short = str(saved(tmp_path, **amass()))
    with pytest.raises(
        ConfigError, match=r"motion\.npz: the motion lasts 0\.03 s, it cannot start"
    ):
        read_motion(short, body, torch.zeros(2), fps=30.0, start=2.0, seconds=1.0)


def test_a_skeleton_is_read_under_a_root_that_stands_still(body, tmp_path, caplog):
    motion = as_rig(body, *acted(frames=8), frames_of_joints=odd_frames(0), unit=100.0)
    plain, carried = tmp_path / "plain.bvh", tmp_path / "carried.bvh"
    plain.write_text(bvh(motion))
    carried.write_text(bvh(under_a_reference(motion)))
    options = {"fps": 30.0, "start": 0.0, "seconds": 1.0}
    read = [read_motion(str(path), body, torch.zeros(2), **options) for path in (plain, carried)]
    assert read[0].transl[:, 2].diff().min() > 0.01
    torch.testing.assert_close(read[1].transl, read[0].transl, atol=1e-5, rtol=0)
    assert caplog.messages == []


def test_joints_whose_places_are_not_read_are_named_with_their_file(body, tmp_path, caplog):
    motion = as_rig(body, *acted(frames=8), frames_of_joints=odd_frames(0), unit=100.0)
    sliding = motion.offsets[16] + torch.linspace(0, 5, 8).double()[:, None]
    path = tmp_path / "sliding.bvh"
    path.write_text(bvh(replace(motion, positions=motion.positions | {16: sliding})))
    read_motion(str(path), body, torch.zeros(2), fps=30.0, start=0.0, seconds=1.0)
    (said,) = caplog.messages
    assert said.startswith(f"{path}: positions of LeftArm change, which is not read")


def test_a_skeleton_of_unknown_names_is_refused_with_its_file(body, tmp_path):
    path = tmp_path / "crab.bvh"
    path.write_text(
        "HIERARCHY\nROOT Claw\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n}\n"
        "MOTION\nFrames: 1\nFrame Time: 0.1\n0 0 0\n"
    )
    with pytest.raises(ArtifactError, match=r"crab\.bvh: the skeleton has no joint for pelvis"):
        read_motion(str(path), body, torch.zeros(2), fps=30.0, start=0.0, seconds=1.0)
