import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.model import (
    AvatarModel,
    encode,
    render_avatar,
)
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.geometry.cameras import camera_centres
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.geometry.skinning import (
    invert_rigid,
    skin_points,
    transform_points,
)
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.motion.trajectory import instants
from deblur_avatar.rendering.covariances import upper_triangles, whole_matrices
from deblur_avatar.rendering.rasterize import rasterize

pytestmark = pytest.mark.portable

SIZE = 24


@pytest.fixture
def dressed_up(body, start):
    """An avatar with all its networks, whose deformations can be seen."""
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    betas = torch.tensor([0.3, 0.2])
    model = AvatarModel.create(start.model, body, betas, 5, 120, "srgb", generator)
    with torch.no_grad():
        model.gaussians.features.normal_(generator=generator)
        model.gaussians.opacity_logits.fill_(2.0)
    return model


def picture(model, poses, front, **options):
    return render_avatar(model, poses, front.camera(0), **options)[0]


def one(poses, index):
    return dataclasses.replace(
        poses,
        global_orient=poses.global_orient[index : index + 1],
        body_pose=poses.body_pose[index : index + 1],
        transl=poses.transl[index : index + 1],
    )


def repeated(poses, count):
    return dataclasses.replace(
        poses,
        global_orient=poses.global_orient.repeat(count, 1),
        body_pose=poses.body_pose.repeat(count, 1, 1),
        transl=poses.transl.repeat(count, 1),
    )


def canonical_rotations():
    turns = torch.zeros(24, 3)
    turns[1, 2], turns[2, 2] = torch.pi / 4, -torch.pi / 4
    return axis_angle_to_matrix(turns)


def test_the_canonical_pose_moves_nothing(dressed_up):
    transforms = dressed_up.transforms(canonical_rotations(), torch.zeros(3))
    identity = torch.eye(4).expand(24, 4, 4)
    torch.testing.assert_close(transforms, identity, atol=1e-6, rtol=0)


def test_transforms_take_canonical_points_to_the_posed_body(dressed_up, body, swinging):
    poses = swinging(2, 30.0)
    transforms = dressed_up.transforms(axis_angle_to_matrix(poses.axis_angle), poses.transl)
    posed = skin_points(dressed_up.canonical_vertices, body.lbs_weights, transforms)
    expected = posed_vertices(
        body, dressed_up.betas, poses.global_orient, poses.body_pose, poses.transl
    )
    rigid = body.lbs_weights.amax(1) == 1  # blending twice is not blending once
    assert rigid.sum() > 100
    torch.testing.assert_close(posed[:, rigid], expected[:, rigid], atol=1e-6, rtol=0)


def test_the_box_is_a_tenth_larger_on_each_side_than_the_canonical_body(dressed_up):
    low, high = dressed_up.canonical_vertices.amin(0), dressed_up.canonical_vertices.amax(0)
    torch.testing.assert_close(dressed_up.box[0], low - 0.1 * (high - low))
    torch.testing.assert_close(dressed_up.box[1], high + 0.1 * (high - low))


def test_undeformed_gaussians_stay_where_they_are_in_the_canonical_pose(dressed_up):
    frame_state = dressed_up.condition(canonical_rotations(), 0, deform=False)
    identity = torch.eye(4).expand(1, 24, 4, 4)
    means, covars = frame_state.posed(identity)
    torch.testing.assert_close(means[0], dressed_up.gaussians.means)
    torch.testing.assert_close(covars[0], dressed_up.canonical_covariances())
    # Quaternions are still the identity, so axes are not mixed.
    expected = torch.zeros(len(means[0]), 6)
    expected[:, [0, 3, 5]] = dressed_up.gaussians.scales.square()
    torch.testing.assert_close(covars[0], expected)


def test_clothes_move_with_the_pose_but_not_with_the_place(dressed_up, swinging):
    rotations = axis_angle_to_matrix(swinging(2, 60.0).axis_angle)
    here, swung = (dressed_up.condition(value, 0) for value in rotations)
    assert (here.means - swung.means).abs().max() > 1e-4
    turned = rotations[0].clone()
    turned[0] = axis_angle_to_matrix(torch.tensor([0.3, 2.0, -0.5]))
    there = dressed_up.condition(turned, 0)
    assert torch.equal(here.means, there.means)
    assert torch.equal(here.pose_code, there.pose_code)


def test_noise_on_the_pose_reaches_the_networks_alone(dressed_up, swinging):
    rotations = axis_angle_to_matrix(swinging(1, 0.0).axis_angle)[0]
    noise = 0.1 * torch.randn(24, 3, 3, generator=torch.Generator().manual_seed(0))
    plain, noisy = (dressed_up.condition(rotations, 0, pose_noise=n) for n in (None, noise))
    assert (plain.pose_code - noisy.pose_code).abs().max() > 1e-4
    unmoved = dressed_up.condition(rotations, 0, deform=False, pose_noise=noise)
    assert torch.equal(unmoved.means, dressed_up.gaussians.means)


def moved_world(poses, front, model):
    """The same scene, person and camera, somewhere else and turned."""
    rigid = torch.eye(4)
    rigid[:3, :3] = axis_angle_to_matrix(torch.tensor([0.5, -2.0, 0.8]))
    rigid[:3, 3] = torch.tensor([3.0, -1.0, 2.0])
    turn = rigid[:3, :3] @ axis_angle_to_matrix(poses.global_orient)
    pelvis = model.body.joints[0] + model.body.joint_dirs[0] @ model.betas
    transl = transform_points(rigid.expand(len(turn), 4, 4), poses.transl + pelvis) - pelvis
    there = dataclasses.replace(poses, global_orient=matrix_to_axis_angle(turn), transl=transl)
    viewmats = front.viewmats @ invert_rigid(rigid)
    return there, dataclasses.replace(front, viewmats=viewmats)


@pytest.mark.parametrize("networks", [False, True])
def test_moving_person_and_camera_together_changes_no_picture(
    networks, dressed_up, painted, swinging, front
):
    model, poses = dressed_up if networks else painted(), swinging(3, 30.0)
    there, camera = moved_world(poses, front, model)
    before, after = picture(model, poses, front), picture(model, there, camera)
    assert before.max() > 0.3
    torch.testing.assert_close(before, after, atol=2e-3, rtol=0)


def test_view_noise_turns_directions_in_canonical_space(dressed_up, swinging, front):
    poses = swinging(1, 0.0)
    there, camera = moved_world(poses, front, dressed_up)
    noise = axis_angle_to_matrix(torch.tensor([0.3, 0.6, -0.4]))
    colors = []
    for given, cameras in ((poses, front), (there, camera)):
        rotations = axis_angle_to_matrix(given.axis_angle)[0]
        frame_state = dressed_up.condition(rotations, 0)
        transforms = dressed_up.transforms(rotations, given.transl[0])
        for turn in (None, noise):
            colors.append(dressed_up.colors(frame_state, transforms, cameras.viewmats[0], turn))
    assert (colors[0] - colors[1]).abs().max() > 1e-3
    torch.testing.assert_close(colors[0], colors[2], atol=1e-4, rtol=0)
    torch.testing.assert_close(colors[1], colors[3], atol=1e-4, rtol=0)


def test_colours_are_seen_along_the_line_from_the_camera(dressed_up, swinging, front):
    poses = swinging(1, 0.0)
    rotations = axis_angle_to_matrix(poses.axis_angle)[0]
    frame_state = dressed_up.condition(rotations, 0)
    transforms = dressed_up.transforms(rotations, poses.transl[0])
    colors = dressed_up.colors(frame_state, transforms, front.viewmats[0])
    means, _ = frame_state.posed(transforms[None])
    seen = means[0] - camera_centres(front.viewmats[0])
    blended = (frame_state.lbs_weights @ transforms.flatten(1)).unflatten(1, (4, 4))
    back = torch.nn.functional.normalize((blended[:, :3, :3].mT @ seen[..., None])[..., 0], dim=1)
    expected = dressed_up.color(dressed_up.gaussians.features, back, frame_state.deformation, 0)
    torch.testing.assert_close(colors, expected, atol=1e-6, rtol=0)


def test_plain_colours_are_the_first_three_features(painted, swinging, front):
    model = painted()
    rotations = axis_angle_to_matrix(swinging(1, 0.0).axis_angle)[0]
    frame_state = model.condition(rotations, 0)
    transforms = model.transforms(rotations, torch.zeros(3))
    colors = model.colors(frame_state, transforms, front.viewmats[0])
    assert torch.equal(colors, model.gaussians.features[:, :3].sigmoid())
    assert model.view_noise(torch.Generator()) is None


def test_a_still_body_does_not_blur(dressed_up, swinging, front):
    poses = one(swinging(3, 30.0), 0)
    sharp = picture(dressed_up, poses, front)
    blurred = picture(dressed_up, repeated(poses, 5), front, average=True)
    assert blurred.shape == (1, SIZE, SIZE, 3)
    torch.testing.assert_close(blurred, sharp, atol=1e-6, rtol=0)


def test_an_exposure_is_dressed_and_coloured_for_its_middle(dressed_up, swinging, front):
    poses = swinging(3, 30.0)
    rotations = axis_angle_to_matrix(poses.axis_angle)
    transforms = dressed_up.transforms(rotations, poses.transl)
    with torch.no_grad():
        frame_state = dressed_up.condition(rotations[1], 4)
        colors = dressed_up.colors(frame_state, transforms[1], front.viewmats[0])
        drawn = rasterize(
            *frame_state.posed(transforms), dressed_up.gaussians.opacities, colors,
            front.viewmats[0], front.Ks[0], SIZE, SIZE,
        )  # fmt: skip
    blurred = picture(dressed_up, poses, front, average=True)[0]
    torch.testing.assert_close(blurred, drawn.image.mean(0), atol=1e-6, rtol=0)
    sharp = picture(dressed_up, poses, front)  # each frame_state for itself
    assert (blurred - sharp.mean(0)).abs().max() > 1e-4


@pytest.mark.parametrize("light", ["srgb", "linear"])
def test_light_is_averaged_before_it_is_encoded(light, painted, swinging, front):
    model, poses = painted(light=light), swinging(4, 40.0)
    sharp = picture(model, poses, front)
    blurred = picture(model, poses, front, average=True)[0]
    if light == "linear":
        expected = linear_to_srgb(srgb_to_linear(sharp).mean(0))
        assert (expected - sharp.mean(0)).abs().max() > 0.05
    else:
        expected = sharp.mean(0)
    torch.testing.assert_close(blurred, expected, atol=1e-5, rtol=0)


def test_encoding_keeps_colours_in_range_and_gradients_finite():
    light = torch.tensor([-0.5, 0.0, 0.2, 1.0, 1.5]).reshape(1, 5, 1).repeat(1, 1, 3)
    light.requires_grad_()
    for name in ("srgb", "linear"):
        encoded = encode(light, name)
        assert encoded.min() == 0
        torch.testing.assert_close(encoded.max(), torch.tensor(1.0))
        (gradient,) = torch.autograd.grad(encoded.sum(), light)
        assert torch.isfinite(gradient).all()


def test_coverage_is_that_of_the_picture(painted, swinging, front):
    poses = swinging(2, 0.0)
    images, alphas = render_avatar(
        painted(), poses, front.camera(0),
        background=torch.tensor([0.0, 0.0, 1.0]),
    )  # fmt: skip
    corner = alphas[:, 0, 0]
    assert corner.abs().max() < 1e-3
    torch.testing.assert_close(images[:, 0, 0], torch.tensor([[0.0, 0, 1]] * 2))
    assert alphas.amax() > 0.9


def test_true_ends_and_enough_instants_reproduce_a_true_exposure(painted, swinging, front):
    def exposure(u):
        ends = swinging(2, 25.0)
        body_pose = ends.body_pose[:1] + u[:, None, None] * ends.body_pose.diff(dim=0)
        transl = ends.transl[:1] + u[:, None] * ends.transl.diff(dim=0)
        still = torch.zeros(len(u), 3)
        poses = Poses(betas=ends.betas, global_orient=still, body_pose=body_pose, transl=transl)
        return picture(painted(), poses, front, average=True)

    truth = exposure(instants(256, "midpoints"))
    errors = [(exposure(instants(n, "midpoints")) - truth).square().mean() for n in (1, 4, 16)]
    assert errors[0] > 20 * errors[1] > 20 * errors[2]
    assert errors[2] < 1e-6  # 60 dB


@pytest.mark.parametrize("networks", [False, True])
def test_a_saved_avatar_draws_the_same_picture_bit_for_bit(
    networks, dressed_up, painted, body, swinging, front, tmp_path
):
    model = dressed_up if networks else painted()
    poses = swinging(3, 30.0)
    picture(model, poses, front)  # whatever is remembered is remembered from before the move
    with torch.no_grad():
        model.gaussians.means.add_(0.01)
    model.to_artifact(7).save(tmp_path / "avatar")
    loaded = AvatarModel.from_artifact(Avatar.load(tmp_path / "avatar"), body, torch.device("cpu"))
    assert torch.equal(picture(loaded, poses, front), picture(model, poses, front))
    assert loaded.frames == model.frames
    assert loaded.params == model.params
    assert loaded.light == model.light


def test_an_artifact_does_not_change_when_fitting_goes_on(dressed_up, body):
    artifact = dressed_up.to_artifact(1)
    tensors = {"means": artifact.means, **artifact.networks}
    before = {name: value.clone() for name, value in tensors.items()}
    again = AvatarModel.from_artifact(artifact, body, torch.device("cpu"))
    with torch.no_grad():
        for model in (dressed_up, again):
            for value in model.parameters():
                value.add_(1.0)
    assert all(torch.equal(value, before[name]) for name, value in tensors.items())


def test_without_a_skinning_network_other_gaussians_have_other_weights(painted, body, swinging):
    model = painted()
    rotations = axis_angle_to_matrix(swinging(1, 0.0).axis_angle)[0]
    before = model.condition(rotations, 0).lbs_weights
    with torch.no_grad():
        model.gaussians.means = torch.nn.Parameter(model.gaussians.means.flip(0))
    torch.testing.assert_close(model.condition(rotations, 0).lbs_weights, before.flip(0))
    with torch.no_grad():
        model.gaussians.means.copy_(model.gaussians.means.flip(0))
    model.invalidate_neighbours()
    torch.testing.assert_close(model.condition(rotations, 0).lbs_weights, before)


def test_frames_after_the_last_are_drawn_with_its_code(dressed_up, swinging, front):
    poses = swinging(1, 0.0)
    default, last, first = (picture(dressed_up, poses, front, frame=f) for f in (-1, 4, 0))
    assert torch.equal(default, last)
    assert not torch.equal(default, first)


def test_equal_generators_make_equal_gaussians(body, start):
    def make(seed):
        generator = torch.Generator().manual_seed(seed)
        return AvatarModel.create(
            start.model, body, torch.zeros(2), 5, 30, "srgb", generator
        ).gaussians.means

    assert torch.equal(make(1), make(1))
    assert not torch.equal(make(1), make(2))


def test_networks_of_another_composition_are_refused(dressed_up, body):
    artifact = dressed_up.to_artifact(1)
    networks = {k: v for k, v in artifact.networks.items() if not k.startswith("color.latents")}
    broken = dataclasses.replace(artifact, networks=networks)
    with pytest.raises(ArtifactError, match=r"do not fit model: \['color.latents.weight'\]"):
        AvatarModel.from_artifact(broken, body, torch.device("cpu"))


def test_a_composition_from_another_version_is_refused(dressed_up, body):
    artifact = dressed_up.to_artifact(1)
    params = artifact.model["params"] | {"hair": None}
    broken = dataclasses.replace(artifact, model=artifact.model | {"params": params})
    with pytest.raises(ConfigError, match="avatar model: unknown key 'hair'"):
        AvatarModel.from_artifact(broken, body, torch.device("cpu"))


def test_a_saved_avatar_says_its_precision_unless_it_is_that_of_old_avatars(
    body, start, painted, tmp_path
):
    def saved(precision):
        params = start.model.model_copy(update={"precision": precision})
        model = AvatarModel.create(params, body, torch.zeros(2), 5, 30, "srgb", torch.Generator())
        return model.to_artifact(1)

    for precision in ("bfloat16", "float32"):
        again = AvatarModel.from_artifact(saved(precision), body, torch.device("cpu"))
        assert again.params.precision == precision
    assert saved("float32").model["params"]["precision"] == "float32"
    # Avatars of before there was a choice, and those without networks, have the same bytes today.
    assert "precision" not in saved("bfloat16").model["params"]
    plain = painted().to_artifact(1)
    assert "precision" not in plain.model["params"]
    assert AvatarModel.from_artifact(plain, body, torch.device("cpu")).params.precision is None


def test_networks_are_computed_in_the_precision_that_the_parameters_say(
    dressed_up, body, start, swinging, front
):
    params = start.model.model_copy(update={"precision": "float32"})
    full = AvatarModel.create(params, body, dressed_up.betas, 5, 120, "srgb", torch.Generator())
    full.load_state_dict(dressed_up.state_dict())
    poses = swinging(2, 30.0)
    rotations = joint_rotations(poses)[0]
    half, whole = dressed_up.condition(rotations, 0), full.condition(rotations, 0)
    assert not torch.equal(half.deformation, whole.deformation)
    assert not torch.equal(dressed_up.weights_at(half.means), full.weights_at(half.means))
    transforms = full.transforms(rotations, poses.transl[0])
    one, other = (model.colors(half, transforms, front.viewmats[0]) for model in (dressed_up, full))
    assert not torch.equal(one, other)
    found, wanted = picture(dressed_up, poses, front), picture(full, poses, front)
    assert (found - wanted).square().mean().sqrt() < 0.01


def test_covariance_factors_are_square_roots_of_covariances_after_deformation_too(
    dressed_up, swinging
):
    frame_state = dressed_up.condition(axis_angle_to_matrix(swinging(1, 0.0).axis_angle)[0], 0)
    _, covars = frame_state.posed(torch.eye(4).expand(1, 24, 4, 4))
    whole = frame_state.covariance_factors @ frame_state.covariance_factors.mT
    torch.testing.assert_close(upper_triangles(whole), covars[0])
    assert torch.linalg.eigvalsh(whole_matrices(covars[0]).double()).min() > 0
