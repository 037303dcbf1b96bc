"""Tests of the posed body's silhouette."""

import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.body_silhouette import silhouette_distance


def test_distances_are_metres_at_the_depth_of_the_body(filmed):
    poses, camera = filmed.poses.at([0]), filmed.camera
    distance = silhouette_distance(posed(filmed.body, poses), camera)
    inside = distance == 0
    row, column = (int(place) for place in np.argwhere(inside)[0])  # the top of the head
    # Five pixels above it; the camera stands 4 m away.
    assert distance[row - 5, column] == pytest.approx(5 * 4 / float(camera.K[0, 0]), rel=0.05)
    away = dataclasses.replace(poses, transl=poses.transl + torch.tensor([50.0, 0, 0]))
    assert np.isinf(silhouette_distance(posed(filmed.body, away), camera)).all()
