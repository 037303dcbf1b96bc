"""Initialisation: root position and orientation from the torso, smooth over the clip.

F frames, L landmarks, D control values of a uniform cubic B-spline over time.
"""

import torch
from jaxtyping import Float
from scipy.interpolate import BSpline
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.body_estimation.body_landmarks import TORSO, LandmarkMap
from deblur_avatar.body_estimation.pace import Pace
from deblur_avatar.body_estimation.triangulation import Triangulated
from deblur_avatar.errors import ArtifactError


def first_guess(
    body: Body, marks: LandmarkMap, found: Triangulated, basis: Float[Tensor, "F D"]
) -> tuple[Float[Tensor, "F 3 3"], Float[Tensor, "D 3"]]:
    """Smooth turn of the torso, and control values of its place.

    In each frame they are the rigid motion that best fits four landmarks.

    Source: Umeyama, "Least-squares estimation of transformation parameters", 1991, without scale.

    Raises:
        ArtifactError: if shoulders and hips are known in no frame.
    """
    rows = [marks.rows.index(landmark) for landmark, _ in TORSO]
    rest = body.joints[[SMPL_JOINT_NAMES.index(name) for _, name in TORSO]]
    whole = torch.nonzero(found.found[:, rows].all(1)).flatten()
    if not len(whole):
        raise ArtifactError("no frame shows both shoulders and both hips; check the videos")
    # A frame without a torso takes over its nearest neighbour's.
    frames = torch.arange(len(found.points))
    nearest = whole[(frames[:, None] - whole).abs().argmin(1)]
    seen = found.points[nearest][:, rows]
    middle, rest_middle = seen.mean(1, keepdim=True), rest.mean(0)
    matrices = (seen - middle).transpose(1, 2) @ (rest - rest_middle)
    smoother = basis @ torch.linalg.pinv(basis)
    orient = torch.einsum("fg,gij->fij", smoother, _nearest_rotation(matrices))
    orient = _nearest_rotation(orient)
    # The pelvis stays at `joints[0]` when the body turns.
    pivot = body.joints[0]
    transl = middle[:, 0] - (orient @ (rest_middle - pivot)) - pivot
    return orient, torch.linalg.pinv(basis) @ transl


def spline_basis(pace: Pace, knot_seconds: float) -> Float[Tensor, "F D"]:
    """What each control value of a uniform cubic B-spline adds to each frame.

    Args:
        pace: of the frames, at any spacing.
        knot_seconds: between two knots; rounded to whole frames.
    """
    spacing, places = max(1, round(knot_seconds / pace.interval)), pace.places
    last = max(1, -(-float(places[-1]) // spacing)) if len(places) > 1 else 0
    knots = torch.arange(-3, int(last) + 4, dtype=torch.float64).numpy()
    dense = BSpline.design_matrix((places / spacing).numpy(), knots, 3).toarray()
    return torch.from_numpy(dense).float()


def _nearest_rotation(matrices: Float[Tensor, "F 3 3"]) -> Float[Tensor, "F 3 3"]:
    left, _, right = torch.linalg.svd(matrices)
    mirror = torch.linalg.det(left @ right)
    return torch.cat([left[..., :2], left[..., 2:] * mirror[:, None, None]], dim=-1) @ right
