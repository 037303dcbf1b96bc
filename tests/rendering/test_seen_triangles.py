import numpy as np
import torch

from deblur_avatar.geometry.cameras import Camera, look_at
from deblur_avatar.rendering.seen_triangles import seen_triangles

CAMERA = Camera(
    torch.tensor([[40.0, 0, 8], [0, 40, 6], [0, 0, 1]]),
    look_at(torch.tensor([0.0, 0, 4]), torch.zeros(3), torch.tensor([0.0, 1, 0])),
    16,
    12,
)


def upright(height: float, depth: float) -> np.ndarray:
    """A triangle towards the camera, its tip up."""
    corners = [[-height, -height, depth], [height, -height, depth], [0, height, depth]]
    return np.array(corners, np.float32)


def test_the_nearest_triangle_hides_those_behind():
    vertices = np.concatenate([upright(0.6, -1.0), upright(0.2, 1.0)])
    seen = seen_triangles(vertices, np.array([[0, 1, 2], [3, 4, 5]]), CAMERA)
    assert seen.shape == (12, 16)
    assert seen[6, 8] == 1  # the small one, in the middle
    assert seen[9, 4] == 0  # beside it
    assert seen[0, 0] == -1


def test_a_pixel_sees_what_its_middle_meets():
    ahead = np.array([[0.0, -5, 0], [5, -5, 0], [0, 5, 0], [5, 5, 0]], np.float32)  # right half
    seen = seen_triangles(ahead, np.array([[0, 1, 2], [1, 3, 2]]), CAMERA)
    assert (seen[:, 8:] >= 0).all()
    assert (seen[:, :8] == -1).all()
