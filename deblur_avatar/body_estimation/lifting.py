"""2D-to-3D lifting: landmarks of one camera, with a detector's guess of their depth.

A detector that sees one picture also guesses each landmark's place about the hips, in metres and in
the camera's axes (`Landmarks.world`). Depth from the camera is not in it. That follows from size:
a person as tall as the body is expected to be, seen so large through this focal length, stands so
far away. F frames, L landmarks, D control values of a spline over time.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.body_estimation.landmark_track import sizes
from deblur_avatar.body_estimation.pace import Pace, second_differences
from deblur_avatar.body_estimation.triangulation import Triangulated

DEPTH_ACCELERATION = 3.0  # m/s^2: how fast a person's distance as a whole changes its speed
PIXEL_SHARE = 0.03  # of the person's size in the picture: errors of what is lifted
ROUNDS = 3  # of reweighting
TALLEST = 3.0  # metres; what stands out further is no person's


def lift(
    pixels: Float[Tensor, "F L 2"],
    confidences: Float[Tensor, "F L"],
    around_hips: Float[Tensor, "F L 3"],
    K: Float[Tensor, "3 3"],
    viewmat: Float[Tensor, "4 4"],
    basis: Float[Tensor, "F D"],
    extent: float,
    pace: Pace,
    *,
    any_pose: bool,
) -> Triangulated:
    """Find the smooth way of the hips that puts a detector's guess over the picture.

    A place t of the hips is seen where it should be if f (x + t_x) = (u - c) (z + t_z): linear in
    t, so that the whole way is one least-squares problem, weighted anew for outliers.

    Args:
        pixels: seen, of one view.
        confidences: 0 where not seen.
        around_hips: metres, the camera's axes.
        K: intrinsics.
        viewmat: world to camera.
        basis: frames from control values.
        extent: the person's size in the picture, pixels.
        pace: of the frames.
        any_pose: the person may lie, of which detectors guess the shape worse than the picture: of
            the guess only depth is kept, and points lie on the rays to where they are seen.

    Returns:
        Points in the world; found where they were seen.
    """
    guess, pixels, basis = around_hips.double(), pixels.double(), basis.double()
    f, c = K[[0, 1], [0, 1]].double(), K[:2, 2].double()
    rows = torch.zeros(*pixels.shape, 3).double()  # F L 2 3
    rows[..., 0, 0], rows[..., 1, 1] = f[0], f[1]
    rows[..., 2] = -(pixels - c)
    right = (pixels - c) * guess[..., 2:] - f * guess[..., :2]
    weights = confidences.double()
    # A residual of these equations is pixels times metres of depth.
    depth = _typical_depth(guess, confidences, f, extent, any_pose)
    sigma = PIXEL_SHARE * extent * depth
    way = torch.zeros(len(pixels), 3).double()
    for _ in range(ROUNDS):
        way = _smooth_way(rows / sigma, right / sigma, weights, basis, pace)
        errors = ((rows @ way[:, None, :, None])[..., 0] - right).norm(dim=-1)
        weights = confidences.double() / (1 + (errors / sigma).square())
    points = guess + way[:, None]
    if any_pose:
        z = points[..., 2:]
        points = torch.cat([(pixels - c) / f * z, z], dim=-1)
    inverse = torch.linalg.inv(viewmat.double())
    world = points @ inverse[:3, :3].T + inverse[:3, 3]
    seen = _usable(confidences, around_hips)
    return Triangulated(
        points=torch.where(seen[..., None], world, 0.0).float(),
        found=seen,
        inliers=seen[None],
        residuals=torch.zeros(1, *seen.shape),
    )


def _usable(
    confidences: Float[Tensor, "F L"], around_hips: Float[Tensor, "F L 3"]
) -> Bool[Tensor, "F L"]:
    length = around_hips.norm(dim=-1)
    return (confidences > 0) & (length.amax(1, keepdim=True) > 0) & (length < TALLEST)


def _typical_depth(
    guess: Float[Tensor, "F L 3"],
    confidences: Float[Tensor, "F L"],
    f: Float[Tensor, " 2"],
    extent: float,
    any_pose: bool,
) -> float:
    shown = guess[(confidences > 0).any(1)][..., :2]
    return float(f[1] * sizes(shown, any_pose=any_pose).median() / extent)


def _smooth_way(
    rows: Float[Tensor, "F L 2 3"],
    right: Float[Tensor, "F L 2"],
    weights: Float[Tensor, "F L"],
    basis: Float[Tensor, "F D"],
    pace: Pace,
) -> Float[Tensor, "F 3"]:
    """Weighted least squares for a spline's control values, kept from accelerating."""
    frames, knots = basis.shape
    normal = torch.einsum("flai,fl,flaj->fij", rows, weights, rows)
    target = torch.einsum("flai,fl,fla->fi", rows, weights, right)
    system = torch.einsum("fd,fij,fe->diej", basis, normal, basis)
    if frames > 2:
        bends = second_differences(basis, pace) / (DEPTH_ACCELERATION * pace.interval**2)
        stiff = bends.T @ bends
        # Sideways the picture says where the hips are; only their depth needs holding.
        system[:, 2, :, 2] += stiff
    flat = system.reshape(3 * knots, 3 * knots)
    flat = flat + 1e-6 * flat.diagonal().mean() * torch.eye(3 * knots).double()
    solved = torch.linalg.solve(flat, (basis.T @ target).reshape(-1))
    return basis @ solved.reshape(knots, 3)
