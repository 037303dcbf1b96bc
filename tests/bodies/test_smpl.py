import pickle
import sys
import types

import numpy as np
import pytest
import torch
from scipy import sparse

from deblur_avatar.artifacts.body import (
    SMPL_JOINT_NAMES,
    SMPL_PARENTS,
    Body,
)
from deblur_avatar.bodies.posed_body import (
    posed_joints,
    posed_vertices,
    shaped_joints,
    shaped_vertices,
)
from deblur_avatar.bodies.smpl import read_smpl
from deblur_avatar.errors import ArtifactError, ConfigError

VERTICES, SHAPES = 60, 6


@pytest.fixture
def content():
    """An SMPL model of a few points, keys and types as in the published file."""
    draw = np.random.default_rng(3)
    regressor = np.zeros((24, VERTICES))
    for joint in range(24):
        regressor[joint, draw.choice(VERTICES, 4, replace=False)] = 0.25
    weights = draw.random((VERTICES, 24)) ** 8
    parents = np.array(SMPL_PARENTS, np.int64)
    parents[0] = 4294967295  # as published: -1 as an unsigned number
    return {
        "v_template": draw.normal(size=(VERTICES, 3)),
        "shapedirs": draw.normal(size=(VERTICES, 3, SHAPES)) * 0.01,
        "posedirs": draw.normal(size=(VERTICES, 3, 207)) * 0.01,
        "weights": weights / weights.sum(1, keepdims=True),
        "J_regressor": sparse.csc_matrix(regressor),
        "kintree_table": np.stack([parents, np.arange(24)]).astype(np.uint32),
        "f": draw.integers(0, VERTICES, (40, 3)).astype(np.uint32),
        "bs_style": "lbs",
        "J": regressor,
    }


@pytest.fixture
def chumpy_array(monkeypatch):
    """Wrap arrays as the published file does; the module is gone when the file is read."""
    module = types.ModuleType("chumpy.ch")
    module.Ch = type("Ch", (), {"__module__": "chumpy.ch"})
    monkeypatch.setitem(sys.modules, "chumpy", types.ModuleType("chumpy"))
    monkeypatch.setitem(sys.modules, "chumpy.ch", module)

    def wrap(array):
        made = module.Ch()
        made.x = array
        return made

    return wrap


def _pickle(path, content):
    path.write_bytes(pickle.dumps(content, protocol=2))
    sys.modules.pop("chumpy", None)
    sys.modules.pop("chumpy.ch", None)
    return path


def _npz(path, content):
    dense = {key: value for key, value in content.items() if isinstance(value, np.ndarray)}
    np.savez(path, J_regressor=content["J_regressor"].toarray(), **dense)
    return path


def _smpl_by_loops(content, betas, pose, transl):
    """SMPL as its paper writes it, one vertex at a time."""
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_rotvec(pose).as_matrix()
    shaped = content["v_template"] + content["shapedirs"][..., : len(betas)] @ betas
    joints = content["J_regressor"].toarray() @ shaped
    feature = np.concatenate([(rotation - np.eye(3)).ravel() for rotation in rotations[1:]])
    offset = content["posedirs"] @ feature
    world = []
    for joint, parent in enumerate(SMPL_PARENTS):
        local = np.eye(4)
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
        world.append(world[parent] @ local if parent >= 0 else local)
    posed = np.zeros_like(shaped)
    for vertex in range(len(shaped)):
        for joint in range(24):
            moved = world[joint][:3, :3] @ (shaped + offset)[vertex]
            moved = moved - world[joint][:3, :3] @ joints[joint] + world[joint][:3, 3]
            posed[vertex] += content["weights"][vertex, joint] * moved
    return posed + transl


def test_a_published_pickle_poses_as_smpl_does(tmp_path, content, chumpy_array):
    stored = {**content, "shapedirs": chumpy_array(content["shapedirs"])}
    body = read_smpl(_pickle(tmp_path / "smpl.pkl", stored), 4)
    draw = np.random.default_rng(0)
    betas, pose = draw.normal(size=4), draw.normal(size=(24, 3)) * 0.5
    transl = np.array([0.1, 0.2, 3.0])
    expected = _smpl_by_loops(content, betas, pose, transl)
    given = [torch.tensor(value, dtype=torch.float32) for value in (betas, pose, transl)]
    posed = posed_vertices(body, given[0], given[1][0], given[1][1:], given[2])
    np.testing.assert_allclose(posed.numpy(), expected, atol=2e-5)


def test_joints_follow_the_shape_through_the_regressor(tmp_path, content):
    body = read_smpl(_npz(tmp_path / "smpl.npz", content), SHAPES)
    betas = torch.tensor([1.0, -2.0, 0.5, 3.0, 0.0, 1.0])
    regressor = torch.tensor(content["J_regressor"].toarray(), dtype=torch.float32)
    expected = regressor @ shaped_vertices(body, betas)
    torch.testing.assert_close(shaped_joints(body, betas), expected, atol=1e-5, rtol=0)


def test_npz_and_pickle_of_one_model_are_one_body(tmp_path, content):
    from_pickle = read_smpl(_pickle(tmp_path / "smpl.pkl", content), 3)
    from_npz = read_smpl(_npz(tmp_path / "smpl.npz", content), 3)
    for name in ("vertices", "shape_dirs", "joints", "joint_dirs", "pose_dirs", "lbs_weights"):
        assert torch.equal(getattr(from_pickle, name), getattr(from_npz, name)), name
    assert from_npz.shape_dirs.shape == (VERTICES, 3, 3)
    assert from_npz.parents == SMPL_PARENTS
    assert from_npz.joint_names == SMPL_JOINT_NAMES
    assert "smpl.is.tue.mpg.de" in from_npz.licence


def test_the_body_is_an_artifact_that_survives_saving(tmp_path, content):
    body = read_smpl(_npz(tmp_path / "smpl.npz", content), 3)
    body.save(tmp_path / "body")
    again = Body.load(tmp_path / "body")
    assert torch.equal(again.pose_dirs, body.pose_dirs)
    assert torch.equal(again.faces, body.faces)


def test_a_missing_file_names_the_page_to_get_it_from(tmp_path):
    with pytest.raises(
        ConfigError, match=r"no SMPL model at .*smpl\.pkl; register at https://smpl"
    ):
        read_smpl(tmp_path / "smpl.pkl", 10)


def test_more_shape_numbers_than_the_file_has_are_refused(tmp_path, content):
    with pytest.raises(ConfigError, match="has 6 shape directions, shape_components asks for 10"):
        read_smpl(_npz(tmp_path / "smpl.npz", content), 10)


def test_a_model_of_another_kind_is_refused(tmp_path, content):
    lacking = {key: value for key, value in content.items() if key not in ("posedirs", "f")}
    with pytest.raises(ArtifactError, match="not an SMPL model: it lacks posedirs, f"):
        read_smpl(_npz(tmp_path / "lacking.npz", lacking), 3)
    swapped = {**content, "kintree_table": content["kintree_table"][:, ::-1]}
    with pytest.raises(ArtifactError, match="24 joints of another order; wanted SMPL"):
        read_smpl(_npz(tmp_path / "swapped.npz", swapped), 3)
    (tmp_path / "smpl.txt").write_text("")
    with pytest.raises(ConfigError, match=r"is a \.pkl or \.npz file, got '\.txt'"):
        read_smpl(tmp_path / "smpl.txt", 3)


def test_arrays_that_disagree_or_are_not_finite_are_refused(tmp_path, content):
    short = {**content, "weights": content["weights"][1:]}
    with pytest.raises(ArtifactError, match=r"weights must be \[V J\] with V = 60, got \(59, 24\)"):
        read_smpl(_npz(tmp_path / "short.npz", short), 3)
    broken = {**content, "posedirs": content["posedirs"] * np.nan}
    with pytest.raises(ArtifactError, match="posedirs holds values that are not finite"):
        read_smpl(_npz(tmp_path / "broken.npz", broken), 3)


def test_weights_that_are_no_shares_are_refused(tmp_path, content):
    for name, weights in (("zero", 0 * content["weights"]), ("minus", -content["weights"])):
        path = _npz(tmp_path / f"{name}.npz", {**content, "weights": weights})
        with pytest.raises(ArtifactError, match="rows of weights must be shares that sum to 1"):
            read_smpl(path, 3)


def test_a_damaged_archive_is_one_clear_error(tmp_path, content):
    path = _npz(tmp_path / "smpl.npz", content)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file"):
        read_smpl(path, 3)


def test_an_archive_with_pickled_objects_is_refused(tmp_path, content):
    path = tmp_path / "smpl.npz"
    np.savez(path, **{key: np.array([value, None], object) for key, value in content.items()})
    with pytest.raises(ArtifactError, match=r"not a readable \.npz file"):
        read_smpl(path, 3)


def test_an_expression_that_would_have_to_run_is_refused(tmp_path, content, chumpy_array):
    made = chumpy_array(1.0)
    type(made).__name__ = type(made).__qualname__ = "MatVecMult"
    sys.modules["chumpy.ch"].MatVecMult = type(made)
    path = _pickle(tmp_path / "smpl.pkl", {**content, "shapedirs": made})
    with pytest.raises(ArtifactError, match="shapedirs is an unevaluated chumpy.MatVecMult"):
        read_smpl(path, 3)


@pytest.mark.parametrize("shapes", [4, 10, 300])
def test_smplx_poses_and_shapes_alike(tmp_path, content, shapes):
    smplx = pytest.importorskip("smplx", reason="smplx is not a dependency")
    draw = np.random.default_rng(shapes)
    content["shapedirs"] = draw.normal(size=(VERTICES, 3, shapes)) * 0.01
    path = _pickle(tmp_path / "SMPL_NEUTRAL.pkl", content)
    face = dict.fromkeys(["nose", "reye", "leye", "rear", "lear"], 0)  # of its 6890 vertices
    theirs = smplx.SMPL(
        str(path), num_betas=shapes, vertex_ids=face, use_hands=False, use_feet_keypoints=False
    )
    body = read_smpl(path, shapes)
    generator = torch.Generator().manual_seed(shapes)
    for _ in range(5):
        betas = torch.randn(shapes, generator=generator)
        pose = torch.randn(24, 3, generator=generator) * 0.6
        transl = torch.randn(3, generator=generator)
        given = theirs(
            betas=betas[None],
            global_orient=pose[None, 0],
            body_pose=pose[None, 1:].flatten(1),
            transl=transl[None],
        )
        ours = posed_vertices(body, betas, pose[0], pose[1:], transl)
        torch.testing.assert_close(ours, given.vertices[0], atol=1e-5, rtol=0)
        joints = posed_joints(body, betas, pose[0], pose[1:], transl)
        torch.testing.assert_close(joints, given.joints[0, :24], atol=1e-5, rtol=0)
