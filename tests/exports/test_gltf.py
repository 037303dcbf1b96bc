"""glTF files, read by trimesh and posed by the specification's own formulas."""

import dataclasses
import json
import struct

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation, Slerp

from deblur_avatar.bodies import smpl
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.gltf_rig import skin_influences
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.exports.shown_motion import shown_motions
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.rendering.covariances import covariances

RIG = {
    "format": "gltf_rig",
    "motions": ["own", "builtin:jumping_jacks"],
    "fps": 30.0,
    "seconds": 1.0,
}
TYPES = {5126: np.float32, 5125: np.uint32, 5123: np.uint16, 5121: np.uint8}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Document:
    """A .glb as the specification reads it."""

    def __init__(self, path):
        content = path.read_bytes()
        magic, version, size = struct.unpack("<4sII", content[:12])
        assert (magic, version, size) == (b"glTF", 2, len(content))
        length, kind = struct.unpack("<I4s", content[12:20])
        assert kind == b"JSON"
        self.said = json.loads(content[20 : 20 + length])
        self.numbers = content[28 + length :]

    def array(self, index):
        accessor = self.said["accessors"][index]
        view = self.said["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        kind, width = TYPES[accessor["componentType"]], WIDTHS[accessor["type"]]
        flat = np.frombuffer(
            self.numbers, kind, accessor["count"] * width, view["byteOffset"]
        ).reshape(-1, width)
        if accessor["type"] == "MAT4":
            return flat.reshape(-1, 4, 4).swapaxes(1, 2)
        return flat[:, 0] if width == 1 else flat

    def vertices(self, animation, seconds):
        """The skinned mesh at a time of an animation."""
        local = [dict(node) for node in self.said["nodes"]]
        (animation,) = (a for a in self.said["animations"] if a["name"] == animation)
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            times, values = self.array(sampler["input"]), self.array(sampler["output"])
            place, path = channel["target"]["node"], channel["target"]["path"]
            if path == "rotation":
                value = Slerp(times, Rotation.from_quat(values))(seconds).as_quat()
            else:
                value = [np.interp(seconds, times, column) for column in values.T]
            local[place][path] = value
        world = {}

        def visit(index, above):
            node = local[index]
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
            matrix[:3, 3] = node.get("translation", [0, 0, 0])
            world[index] = above @ matrix
            for child in node.get("children", []):
                visit(child, world[index])

        for root in self.said["scenes"][0]["nodes"]:
            visit(root, np.eye(4))
        (skin,) = self.said["skins"]
        bind = self.array(skin["inverseBindMatrices"])
        moved = np.stack([world[node] @ bind[i] for i, node in enumerate(skin["joints"])])
        attributes = self.said["meshes"][0]["primitives"][0]["attributes"]
        joints = np.concatenate([self.array(attributes[f"JOINTS_{i}"]) for i in (0, 1)], 1)
        weights = np.concatenate([self.array(attributes[f"WEIGHTS_{i}"]) for i in (0, 1)], 1)
        blended = (weights[..., None, None] * moved[joints]).sum(1)
        points = self.array(attributes["POSITION"])
        return (blended[:, :3, :3] @ points[..., None])[..., 0] + blended[:, :3, 3]


@pytest.fixture
def rig(rough, fitted_run, tmp_path):
    run = fitted_run(rough())
    parse(ExportParams, RIG, "export").export(run, tmp_path / "rig.glb")
    return run, tmp_path / "rig.glb"


def test_the_rig_moves_the_body_as_we_do(rig):
    run, path = rig
    document, axes = Document(path), upright_of(run)
    for motion in shown_motions(run, RIG["motions"], 30.0, 1.0):
        for frame in (0, len(motion.times) - 1):
            body = posed(run.observations.body, motion.poses.at([frame]))
            wanted = axes.points(body.vertices[0])
            read = document.vertices(motion.name, float(motion.times[frame]))
            np.testing.assert_allclose(read, wanted, atol=2e-6)


def test_another_programs_reader_finds_the_body_at_rest_in_the_avatars_colours(rig):
    _, path = rig
    scene = trimesh.load(path)
    (mesh,) = scene.geometry.values()
    assert mesh.bounds[1, 1] - mesh.bounds[0, 1] == pytest.approx(1.7, abs=0.2)
    colors = mesh.visual.vertex_attributes["color"]
    assert np.asarray(colors).std(0).min() > 0.1  # painted, not grey


def test_the_rig_tells_its_licence_and_names_its_joints(rig, body):
    _, path = rig
    said = Document(path).said
    assert said["asset"]["copyright"] == body.licence
    assert [node["name"] for node in said["nodes"][:24]] == list(body.joint_names)
    assert [animation["name"] for animation in said["animations"]] == ["own", "jumping_jacks"]


def test_a_body_that_must_not_be_shared_stays_out(rig, tmp_path):
    run, _ = rig
    bound = dataclasses.replace(run.observations.body, licence=smpl.LICENCE)
    run = dataclasses.replace(run, observations=dataclasses.replace(run.observations, body=bound))
    parse(ExportParams, RIG, "export").export(run, tmp_path / "bound.glb")
    said = Document(tmp_path / "bound.glb").said
    assert not {"meshes", "skins"} & said.keys()
    assert len(said["nodes"]) == 24
    assert len(said["animations"]) == 2


def test_eight_influences_of_a_vertex_sum_to_one_and_unused_ones_are_joint_0():
    weights = np.zeros((2, 24), np.float32)
    weights[0, [3, 9]] = 0.25, 0.75
    weights[1] = 1 / 24
    kept, joints = skin_influences(weights)
    assert kept.shape == joints.shape == (2, 8)
    np.testing.assert_allclose(kept.sum(1), 1, atol=1e-6)
    assert joints[0].tolist() == [9, 3, 0, 0, 0, 0, 0, 0]


def test_static_splats_are_the_pose(rough, fitted_run, tmp_path):
    run = fitted_run(rough())
    exporter = parse(ExportParams, {"format": "gltf_splats", "frame": 3}, "export")
    exporter.export(run, tmp_path / "splats.glb")
    document = Document(tmp_path / "splats.glb")
    (primitive,) = document.said["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert document.said["extensionsUsed"] == ["KHR_gaussian_splatting"]
    read = {
        name.partition(":")[2]: torch.from_numpy(document.array(index).copy())
        for name, index in primitive["attributes"].items()
        if ":" in name
    }
    wanted = upright_of(run).gaussians(posed_frame(run, 3))
    quats = read["ROTATION"][:, [3, 0, 1, 2]]
    torch.testing.assert_close(
        covariances(quats, read["SCALE"]), covariances(wanted.quats, wanted.scales),
        atol=1e-7, rtol=1e-4,
    )  # fmt: skip
    torch.testing.assert_close(read["OPACITY"], wanted.opacities)
    colors = 0.5 + 0.28209479177387814 * read["SH_DEGREE_0_COEF_0"]
    torch.testing.assert_close(colors, wanted.colors, atol=1e-6, rtol=0)
    (points,) = trimesh.load(tmp_path / "splats.glb").geometry.values()
    np.testing.assert_allclose(points.vertices, wanted.means, atol=1e-6)


def test_a_frame_that_is_not_there_is_refused(rough, fitted_run, tmp_path):
    exporter = parse(ExportParams, {"format": "gltf_splats", "frame": 5}, "export")
    with pytest.raises(ConfigError, match="frame 5 of 5"):
        exporter.export(fitted_run(rough()), tmp_path / "splats.glb")
