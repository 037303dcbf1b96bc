import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.networks_avatar import NetworksAvatar
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.geometry.cameras import camera_centres
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.geometry.skinning import (
    invert_rigid,
    skin_points,
    transform_points,
)
from deblur_avatar.imaging.exposure import encode, expose
from deblur_avatar.motion.trajectory import instants
from deblur_avatar.rendering.covariances import upper_triangles, whole_matrices
from tests.changed_parameters import changed

pytestmark = pytest.mark.portable

SIZE = 24


@pytest.fixture
def dressed_up(body, recipe):
    """An avatar with all its networks, whose deformations can be seen."""
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    betas = torch.tensor([0.3, 0.2])
    model = NetworksAvatar.create(recipe.model, body, betas, 5, 120, "srgb", generator)
    with torch.no_grad():
        model.gaussians.features.normal_(generator=generator)
        model.gaussians.opacity_logits.fill_(2.0)
    return model


def picture(model, poses, front, **options):
    return render_avatar(model, poses, front.camera(0), **options)[0]


def rotations_of(poses):
    return axis_angle_to_matrix(poses.axis_angle)


def conditioned(model, rotations, frame=0, transl=None, viewmat=None, step=None):
    """The state of one frame, seen from the origin if it does not matter from where."""
    transl = torch.zeros(3) if transl is None else transl
    viewmat = torch.eye(4) if viewmat is None else viewmat
    return model.condition(rotations, frame, model.transforms(rotations, transl), viewmat, step)


@pytest.fixture
def training(recipe):
    """A step of fitting at an iteration of the paper's, with these settings of the networks."""

    def make(iteration, **nonrigid):
        fitting = changed(recipe, "fitting.nonrigid", **nonrigid).fitting
        return TrainingStep(iteration, 1.0, fitting, torch.Generator().manual_seed(0))

    return make


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


def test_undeformed_gaussians_stay_where_they_are_in_the_canonical_pose(dressed_up, training):
    frame_state = conditioned(dressed_up, canonical_rotations(), step=training(2999, start=3000))
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
    here, swung = (conditioned(dressed_up, value) for value in rotations)
    assert (here.means - swung.means).abs().max() > 1e-4
    turned = rotations[0].clone()
    turned[0] = axis_angle_to_matrix(torch.tensor([0.3, 2.0, -0.5]))
    there = conditioned(dressed_up, turned)
    assert torch.equal(here.means, there.means)
    assert torch.equal(here.pose_code, there.pose_code)


def test_noise_on_the_pose_reaches_the_networks_alone_and_half_of_the_steps(
    dressed_up, swinging, training
):
    rotations = rotations_of(swinging(1, 0.0))[0]
    plain = dressed_up.pose_code(rotations)
    step = training(9000, pose_noise=0.1)
    noisy = [dressed_up.pose_code(rotations, step) for _ in range(40)]
    apart = [float((code - plain).abs().max()) for code in noisy]
    assert 8 < sum(value > 1e-4 for value in apart) < 32
    assert all(value == 0 or value > 1e-4 for value in apart)
    unmoved = conditioned(dressed_up, rotations, step=training(1, start=9, pose_noise=0.1))
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


def colors_of(model, poses, viewmat, noise=None):
    """Colours in a pose, for which the view directions are turned by noise."""
    rotations = rotations_of(poses)[0]
    state = conditioned(model, rotations, 0, poses.transl[0], viewmat)
    transforms = model.transforms(rotations, poses.transl[0])
    codes = torch.zeros(len(state.means), model.params.nonrigid.codes)
    return model.colors(state.means, state.lbs_weights, transforms, codes, viewmat, 0, noise)


def test_view_noise_turns_directions_in_canonical_space(dressed_up, swinging, front):
    poses = swinging(1, 0.0)
    there, camera = moved_world(poses, front, dressed_up)
    noise = axis_angle_to_matrix(torch.tensor([0.3, 0.6, -0.4]))
    colors = [
        colors_of(dressed_up, given, cameras.viewmats[0], turn)
        for given, cameras in ((poses, front), (there, camera))
        for turn in (None, noise)
    ]
    assert (colors[0] - colors[1]).abs().max() > 1e-3
    torch.testing.assert_close(colors[0], colors[2], atol=1e-4, rtol=0)
    torch.testing.assert_close(colors[1], colors[3], atol=1e-4, rtol=0)


def test_the_view_is_turned_in_training_alone(dressed_up, swinging, front, training):
    rotations = rotations_of(swinging(1, 0.0))[0]
    views = [
        conditioned(dressed_up, rotations, viewmat=front.viewmats[0], step=step).colors
        for step in (None, None, training(9000, pose_noise=0.0))
    ]
    assert torch.equal(views[0], views[1])
    assert (views[0] - views[2]).abs().max() > 1e-3


def test_colours_are_seen_along_the_line_from_the_camera(dressed_up, swinging, front):
    poses = swinging(1, 0.0)
    rotations = rotations_of(poses)[0]
    transforms = dressed_up.transforms(rotations, poses.transl[0])
    state = conditioned(dressed_up, rotations, 0, poses.transl[0], front.viewmats[0])
    means, _ = state.posed(transforms[None])
    seen = means[0] - camera_centres(front.viewmats[0])
    blended = (state.lbs_weights @ transforms.flatten(1)).unflatten(1, (4, 4))
    back = torch.nn.functional.normalize((blended[:, :3, :3].mT @ seen[..., None])[..., 0], dim=1)
    codes = torch.zeros(len(back), dressed_up.params.nonrigid.codes)
    expected = dressed_up.color_network(dressed_up.gaussians.features, back, codes, 0)
    found = colors_of(dressed_up, poses, front.viewmats[0])
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)


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
        state = dressed_up.condition(rotations[1], 4, transforms[1], front.viewmats[0])
        drawn = dressed_up.render(state, transforms, front.camera(0))
    blurred = picture(dressed_up, poses, front, average=True)[0]
    torch.testing.assert_close(blurred, drawn.image.mean(0), atol=1e-6, rtol=0)
    sharp = picture(dressed_up, poses, front)  # each frame_state for itself
    assert (blurred - sharp.mean(0)).abs().max() > 1e-4


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
def test_the_rasterizers_average_is_the_exposure_of_sharp_pictures(
    averaging_space, painted, swinging, front
):
    model, poses = painted(averaging_space=averaging_space), swinging(4, 40.0)
    sharp = picture(model, poses, front)
    blurred = picture(model, poses, front, average=True)[0]
    assert (averaging_space == "linear") == bool(
        (expose(sharp, averaging_space) - sharp.mean(0)).abs().max() > 0.05
    )
    torch.testing.assert_close(blurred, expose(sharp, averaging_space), atol=1e-5, rtol=0)


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
    loaded = avatar_from_artifact(Avatar.load(tmp_path / "avatar"), body, torch.device("cpu"))
    assert torch.equal(picture(loaded, poses, front), picture(model, poses, front))
    assert loaded.frames == model.frames
    assert loaded.params == model.params
    assert loaded.averaging_space == model.averaging_space


def test_an_artifact_does_not_change_when_fitting_goes_on(dressed_up, body):
    artifact = dressed_up.to_artifact(1)
    tensors = {"means": artifact.means, **artifact.networks}
    before = {name: value.clone() for name, value in tensors.items()}
    again = avatar_from_artifact(artifact, body, torch.device("cpu"))
    with torch.no_grad():
        for model in (dressed_up, again):
            for value in model.parameters():
                value.add_(1.0)
    assert all(torch.equal(value, before[name]) for name, value in tensors.items())


def test_frames_after_the_last_are_drawn_with_its_code(dressed_up, swinging, front):
    poses = swinging(1, 0.0)
    default, last, first = (picture(dressed_up, poses, front, frame=f) for f in (-1, 4, 0))
    assert torch.equal(default, last)
    assert not torch.equal(default, first)


def test_equal_generators_make_equal_gaussians(body, recipe):
    def make(seed):
        generator = torch.Generator().manual_seed(seed)
        return NetworksAvatar.create(
            recipe.model, body, torch.zeros(2), 5, 30, "srgb", generator
        ).gaussians.means

    assert torch.equal(make(1), make(1))
    assert not torch.equal(make(1), make(2))


def test_what_is_on_disk_has_the_names_that_it_always_had(dressed_up, painted):
    saved = dressed_up.to_artifact(1)
    parts = {name.split(".")[0] for name in saved.networks}
    assert parts == {"pose_encoder", "nonrigid", "skinning", "color"}
    assert saved.model.keys() == {"params", "frames", "light"}
    assert saved.model["params"].keys() == {"nonrigid", "skinning", "color"}
    plain = painted().to_artifact(1)
    assert plain.model["params"] == {"nonrigid": None, "skinning": None, "color": None}
    assert plain.networks == {}


def test_networks_of_another_composition_are_refused(dressed_up, body):
    artifact = dressed_up.to_artifact(1)
    networks = {k: v for k, v in artifact.networks.items() if not k.startswith("color.latents")}
    broken = dataclasses.replace(artifact, networks=networks)
    with pytest.raises(ArtifactError, match=r"do not fit model: \['color.latents.weight'\]"):
        avatar_from_artifact(broken, body, torch.device("cpu"))


def test_a_composition_from_another_version_is_refused(dressed_up, body):
    artifact = dressed_up.to_artifact(1)
    params = artifact.model["params"] | {"hair": None}
    broken = dataclasses.replace(artifact, model=artifact.model | {"params": params})
    with pytest.raises(ConfigError, match="avatar model: unknown key 'hair'"):
        avatar_from_artifact(broken, body, torch.device("cpu"))


def test_a_saved_avatar_says_its_precision_unless_it_is_that_of_old_avatars(
    body, recipe, painted, tmp_path
):
    def saved(precision):
        params = recipe.model.model_copy(update={"precision": precision})
        model = NetworksAvatar.create(
            params, body, torch.zeros(2), 5, 30, "srgb", torch.Generator()
        )
        return model.to_artifact(1)

    for precision in ("bfloat16", "float32"):
        again = avatar_from_artifact(saved(precision), body, torch.device("cpu"))
        assert again.params.precision == precision
    assert saved("float32").model["params"]["precision"] == "float32"
    # Avatars of before there was a choice, and those without networks, have the same bytes today.
    assert "precision" not in saved("bfloat16").model["params"]
    plain = painted().to_artifact(1)
    assert "precision" not in plain.model["params"]
    assert avatar_from_artifact(plain, body, torch.device("cpu")).precision is None


def test_networks_are_computed_in_the_precision_that_the_parameters_say(
    dressed_up, body, recipe, swinging, front
):
    params = recipe.model.model_copy(update={"precision": "float32"})
    full = NetworksAvatar.create(params, body, dressed_up.betas, 5, 120, "srgb", torch.Generator())
    full.load_state_dict(dressed_up.state_dict())
    poses = swinging(2, 30.0)
    rotations = rotations_of(poses)[0]
    half, whole = conditioned(dressed_up, rotations), conditioned(full, rotations)
    assert not torch.equal(half.means, whole.means)
    assert not torch.equal(dressed_up.weights_at(half.means), full.weights_at(half.means))
    assert not torch.equal(half.colors, whole.colors)
    found, wanted = picture(dressed_up, poses, front), picture(full, poses, front)
    assert (found - wanted).square().mean().sqrt() < 0.01


def test_covariance_factors_are_square_roots_of_covariances_after_deformation_too(
    dressed_up, swinging
):
    frame_state = conditioned(dressed_up, rotations_of(swinging(1, 0.0))[0])
    _, covars = frame_state.posed(torch.eye(4).expand(1, 24, 4, 4))
    whole = frame_state.covariance_factors @ frame_state.covariance_factors.mT
    torch.testing.assert_close(upper_triangles(whole), covars[0])
    assert torch.linalg.eigvalsh(whole_matrices(covars[0]).double()).min() > 0
