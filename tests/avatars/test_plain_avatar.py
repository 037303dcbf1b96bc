import torch

from deblur_avatar.geometry.rotations import axis_angle_to_matrix


def test_colours_are_the_features(painted, swinging, front):
    model = painted()
    rotations = axis_angle_to_matrix(swinging(1, 0.0).axis_angle)[0]
    state = model.condition(
        rotations, 0, model.transforms(rotations, torch.zeros(3)), front.viewmats[0]
    )
    assert torch.equal(state.colors, model.gaussians.features.sigmoid())
    assert state.pose_code is None


def test_other_gaussians_have_other_weights(painted, swinging, front):
    model = painted()
    rotations = axis_angle_to_matrix(swinging(1, 0.0).axis_angle)[0]

    def weights():
        transforms = model.transforms(rotations, torch.zeros(3))
        return model.condition(rotations, 0, transforms, front.viewmats[0]).lbs_weights

    before = weights()
    with torch.no_grad():
        model.gaussians.means = torch.nn.Parameter(model.gaussians.means.flip(0))
    torch.testing.assert_close(weights(), before.flip(0))
    with torch.no_grad():
        model.gaussians.means.copy_(model.gaussians.means.flip(0))
    model.invalidate_neighbours()
    torch.testing.assert_close(weights(), before)
