"""Rig in glTF: the fitted skeleton, its motions and, where its licence lets it go, the body.

Conventions. glTF's, the person upright (`upright.py`). Joints are nodes that stand as in the rest
pose (T-pose); a motion is an animation of their rotations and of the root's place. The body is the
skin without clothes, in its rest pose, painted with the colours of the Gaussians nearest to it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.bodies import smpl
from deblur_avatar.bodies.posed_body import shaped_joints, shaped_vertices
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.gltf_file import TRIANGLES, VERTICES, GltfFile
from deblur_avatar.exports.posed_gaussians import canonical_colors
from deblur_avatar.exports.shown_motion import MotionExport, ShownMotion, shown_motions
from deblur_avatar.exports.upright import Upright, rest_pelvis, upright_of
from deblur_avatar.files import write_bytes
from deblur_avatar.geometry.nearest import nearest
from deblur_avatar.geometry.rotations import continuous
from deblur_avatar.imaging.color import srgb_to_linear

PAINTERS = 8  # nearest Gaussians that colour a vertex
MOST_INFLUENCES = 8  # joints a vertex, in two attributes of four


class GltfRigExport(MotionExport):
    """A skeleton in motion, with or without a body."""

    suffix: ClassVar[str] = ".glb"

    format: Literal["gltf_rig"]

    def export(self, run: FittedRun, path: Path) -> None:
        """Write skeleton, motions and body; no body where its licence keeps it."""
        body = run.observations.body
        file = GltfFile(body.licence)
        joints = shaped_joints(body, run.avatar.betas).numpy()
        axes = upright_of(run)
        nodes = _joint_nodes(joints, body.parents, body.joint_names)
        motions = shown_motions(run, self.motions, self.fps, self.seconds)
        file.document |= {
            "scenes": [{"nodes": [0, len(nodes)]}],
            "nodes": nodes,
            "skins": [_skin(file, joints)],
            "animations": [_animation(file, motion, axes, rest_pelvis(run)) for motion in motions],
        }
        if body.licence == smpl.LICENCE:
            file.document["scenes"] = [{"nodes": [0]}]
            del file.document["skins"]  # of nothing
        else:
            nodes.append({"name": run.name, "mesh": 0, "skin": 0})
            file.document |= {"meshes": [_mesh(file, run)], "materials": [MATERIAL]}
        write_bytes(path, file.content())


MATERIAL = {"name": "skin", "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9}}


def _joint_nodes(
    joints: Float[np.ndarray, "J 3"], parents: Sequence[int], names: Sequence[str]
) -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = []
    for joint, (parent, name) in enumerate(zip(parents, names, strict=True)):
        children = [child for child, above in enumerate(parents) if above == joint]
        offset = joints[joint] - (0 if parent < 0 else joints[parent])
        node = {"name": name, "translation": offset.tolist()}
        nodes.append(node | ({"children": children} if children else {}))
    return nodes


def _skin(file: GltfFile, joints: Float[np.ndarray, "J 3"]) -> dict[str, Any]:
    """Joints, and the matrices that take a rest vertex to each joint's own frame."""
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(joints), 1, 1))
    inverse[:, :3, 3] = -joints
    return {"joints": [*range(len(joints))], "inverseBindMatrices": file.accessor(inverse)}


def _animation(
    file: GltfFile, motion: ShownMotion, axes: Upright, pelvis: Float[Tensor, " 3"]
) -> dict[str, Any]:
    quats, places = axes.pose(motion.poses, pelvis)
    turned = continuous(quats).numpy()[..., [1, 2, 3, 0]]
    times = file.accessor(motion.times.float().numpy(), bounds=True)
    outputs = [("translation", 0, places.numpy())]
    outputs += [("rotation", joint, turned[:, joint]) for joint in range(turned.shape[1])]
    return {
        "name": motion.name,
        "samplers": [
            {"input": times, "output": file.accessor(values), "interpolation": "LINEAR"}
            for _, _, values in outputs
        ],
        "channels": [
            {"sampler": index, "target": {"node": joint, "path": path}}
            for index, (path, joint, _) in enumerate(outputs)
        ],
    }


def _mesh(file: GltfFile, run: FittedRun) -> dict[str, Any]:
    body = run.observations.body
    vertices = shaped_vertices(body, run.avatar.betas).numpy()
    weights, bones = skin_influences(body.lbs_weights.numpy())
    attributes = {
        "POSITION": file.accessor(vertices, target=VERTICES, bounds=True),
        "COLOR_0": file.accessor(_painted(run), target=VERTICES),
    }
    for half in range(MOST_INFLUENCES // 4):
        columns = slice(4 * half, 4 * half + 4)
        attributes[f"JOINTS_{half}"] = file.accessor(bones[:, columns], target=VERTICES)
        attributes[f"WEIGHTS_{half}"] = file.accessor(weights[:, columns], target=VERTICES)
    faces = body.faces.numpy().astype(np.uint32).reshape(-1)
    indices = file.accessor(faces, target=TRIANGLES)
    return {
        "name": "body",
        "primitives": [{"attributes": attributes, "indices": indices, "material": 0}],
    }


def skin_influences(
    weights: Float[np.ndarray, "P J"],
) -> tuple[Float[np.ndarray, "P 8"], Any]:
    """The eight largest weights of each vertex, which sum to 1, and their joints; 0 where none."""
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :MOST_INFLUENCES]
    kept = np.take_along_axis(weights, joints, axis=1).astype(np.float64)
    kept = (kept / kept.sum(1, keepdims=True)).astype(np.float32)
    return kept, np.where(kept > 0, joints, 0).astype(np.uint8)


def _painted(run: FittedRun) -> Float[np.ndarray, "P 3"]:
    """Colours of the vertices, linear light."""
    device = torch.device("cpu")
    model = avatar_from_artifact(run.avatar, run.observations.body, device)
    means, colors, opacities = canonical_colors(model, run.observations.camera.viewmat)
    painters = nearest(model.canonical_vertices, means, PAINTERS)
    distance, index = (each.numpy() for each in painters)
    weight = opacities.numpy()[index] / (distance + 1e-3)
    weight /= weight.sum(1, keepdims=True)
    painted = (weight[..., None] * srgb_to_linear(colors).numpy()[index]).sum(1)
    return painted.astype(np.float32)
