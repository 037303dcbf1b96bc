import dataclasses
import hashlib

import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.avatars import networks_avatar, splats
from deblur_avatar.avatars.kinds import AVATARS, avatar_from_artifact
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed_joints
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.imaging import lpips
from deblur_avatar.motion.kinds import KINDS, trajectory_from_artifact
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.trajectory import instants
from deblur_avatar.training.fusion_network import FusionNetwork, FusionNetworkParams
from deblur_avatar.training.params import FitParams
from deblur_avatar.training.schedule import LevelParams, ScheduleParams
from deblur_avatar.training.trainer import AvatarFit, _brought_together
from tests.changed_parameters import changed
from tests.randomness import seeded

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")
FUSION = FusionNetworkParams(
    precision="bfloat16", hidden=(8,), frame_codes=4, color_features=4, pose=True, rate=5e-4
)


def quiet(iteration, terms):
    pass


def paced(schedule, last, levels=()):
    """A schedule on which a run ends at `last`."""
    ends = {"warmup": 1, "trajectory": 2, "fusion": last}
    return schedule.model_copy(update=ends | {"levels": levels})


def motion_of(kind, noise, **changes):
    """Parameters of any kind of trajectory, with five instants where it has several."""
    values = {
        "virtual_poses": 5, "quadrature": "endpoints", "start_noise": noise,
        "pixels_per_pose": 0.0, "shutter": {"kind": "given"}, "knot_frames": 1.0,
        "finest_knot_frames": 1.0, "finer_knots_gain": 0.0, "smoothness": 0.0,
        "rates": {"poses": 1e-3, "transl": 1e-4},
        "priors": {"anchor": 0.0, "depth": 0.0},
    }  # fmt: skip
    values |= changes
    fields = KINDS[kind].Params.model_fields.keys() & values.keys()
    return KINDS[kind].Params(kind=kind, **{name: values[name] for name in fields})


@pytest.fixture
def begin(observations, recipe, schedule):
    """Build a fit from scratch, the same one for the same arguments."""

    def make(
        params=recipe, motion="fixed", noise=0.05, last=18, seen=observations, fused=False,
        count=80, levels=(), **moves,
    ):  # fmt: skip
        torch.manual_seed(0)
        generator = torch.Generator().manual_seed(0)
        model = AVATARS[params.model.kind].create(
            params.model, seen.body, seen.poses.betas, len(seen.frames), count,
            seen.averaging_space, generator,
        )  # fmt: skip
        section = motion_of(motion, noise, **moves)
        apart = torch.Generator().manual_seed(1)  # so that all motions see the same draws
        trajectory = KINDS[motion].create(seen, section, apart)
        blend = FUSION if fused else None
        network = blend and FusionNetwork(
            model.pose_code_size, len(seen.frames), 4, 4, [8], params.model.precision
        )
        fitted = FitParams(
            recipe=params, motion=section, schedule=paced(schedule, last, levels), fusion=blend
        )
        return AvatarFit(model, trajectory, seen, fitted, CPU, generator, network)

    return make


def everything(fit):
    """All unknowns of a fit, cloned."""
    parts = {"model": fit.avatar, "motion": fit.trajectory}
    return {
        f"{part}.{name}": value.detach().clone()
        for part, module in parts.items()
        for name, value in module.named_parameters()
    }


def moved(before, after):
    return {name for name in before if not torch.equal(before[name], after[name])}


def hurried(params):
    """Rates at which sixty steps are enough to see something."""
    params = changed(params, "fitting.rates", features=0.1, opacities=0.2, scales=0.02)
    if params.model.kind == "plain":
        return params
    params = changed(params, "fitting.color", rate=0.02)
    return changed(params, "fitting.skinning", rate=0.01)


@pytest.fixture
def lpips_weights(tmp_path, monkeypatch):
    """Random weights under the names that the environment's files have, as if published."""
    torch.manual_seed(0)
    model = lpips.Lpips()
    for layer in model.features:
        if isinstance(layer, torch.nn.Conv2d):
            torch.nn.init.kaiming_normal_(layer.weight)
            torch.nn.init.zeros_(layer.bias)
    trunk = {f"features.{name}": value for name, value in model.features.state_dict().items()}
    heads = {f"lin{index}.model.1.weight": head for index, head in enumerate(model.heads)}
    for name, content in (("WEIGHTS", trunk), ("HEADS", heads)):
        path = tmp_path / f"{name}.pth"
        torch.save(content, path)
        monkeypatch.setenv(getattr(lpips, f"{name}_VARIABLE"), str(path))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        monkeypatch.setattr(lpips, f"{name}_SHA256", digest)


@pytest.fixture
def quick_pretraining(monkeypatch):
    monkeypatch.setattr(networks_avatar, "PRETRAIN_SAMPLES", 256)
    monkeypatch.setattr(networks_avatar, "PRETRAIN_RATE", 0.02)


def only(params, **weights):
    """No term but those given."""
    params = params.model_copy(update={"losses": dict.fromkeys(params.losses, 0.0) | weights})
    if params.model.kind == "plain":
        return params
    params = changed(params, "fitting.regularisers", isometry_means=0.0, isometry_covars=0.0)
    return changed(params, "fitting.skinning", early=0.0, late=0.0)


@pytest.mark.usefixtures("lpips_weights")
def test_lpips_falls_and_moves_the_avatar_where_its_weights_are_given(begin, plain_recipe):
    params = only(hurried(plain_recipe), lpips=1.0, structure=0.1)
    fit = begin(params=params, last=24)
    before, terms = everything(fit), []
    fit.run(1, 24, "sharp", "mean", lambda _, found: terms.append(found))
    assert {name for name in terms[0] if terms[0][name] > 0} == {"lpips"}
    first, last = (sum(t["lpips"] for t in part) / 4 for part in (terms[:4], terms[-4:]))
    assert last < 0.9 * first
    changed_parts = moved(before, everything(fit))
    assert {f"model.gaussians.{n}" for n in ("features", "means", "log_scales")} <= changed_parts
    assert fit.cost(1.0)["perceptual"] == "lpips_vgg"


def test_without_its_weights_lpips_changes_nothing(begin, recipe, monkeypatch):
    for variable in (lpips.WEIGHTS_VARIABLE, lpips.HEADS_VARIABLE):
        monkeypatch.delenv(variable, raising=False)
    results = []
    for weight in (0.0, 0.01):
        fit = begin(params=changed(recipe, "losses", lpips=weight), last=6)
        fit.run(1, 6, "sharp", "mean", quiet)
        results.append(everything(fit))
        assert fit.cost(1.0)["perceptual"] == "edges"
    assert not moved(*results)


@pytest.mark.usefixtures("quick_pretraining")
def test_fitting_makes_pictures_like_the_frames(begin, observations, recipe):
    params = changed(hurried(recipe), "model.skinning", pretrain=100)
    fit = begin(params=params, count=150, last=60)
    fit.avatar.pretrain(fit._generator)
    losses = []
    fit.run(1, 60, "sharp", "mean", lambda _, terms: losses.append(terms))
    assert set(losses[0]) == {
        "l1", "structure", "mask", "skinning", "isometry_means", "isometry_covars",
    }  # fmt: skip
    first, last = (sum(t["l1"] for t in part) / 4 for part in (losses[:4], losses[-4:]))
    assert last < 0.5 * first
    camera = observations.cameras
    images, _ = render_avatar(fit.avatar, observations.poses, camera.camera(0))
    error = (images[0] - observations.frames[0] / 255).abs().mean()
    black = (observations.frames[0] / 255).mean()
    assert error < 0.4 * black


@pytest.mark.usefixtures("quick_pretraining")
def test_pretraining_teaches_the_bodys_own_weights(begin, recipe):
    avatar = begin(params=changed(recipe, "model.skinning", pretrain=100)).avatar
    before = avatar.skinning_distance(1000, seeded(1)).item()
    avatar.pretrain(seeded(0))
    assert avatar.skinning_distance(1000, seeded(1)).item() < 0.6 * before


def test_without_a_skinning_network_there_is_nothing_to_pretrain(begin, plain_recipe):
    fit = begin(params=plain_recipe)
    before = everything(fit)
    fit.avatar.pretrain(seeded(0))
    assert not moved(before, everything(fit))


def test_equal_seeds_fit_equally_bit_for_bit(begin):
    results = []
    for elsewhere in range(2):
        fit = begin(motion="pair", fused=True)
        torch.manual_seed(elsewhere)  # of third parties; a fit draws from its own generator
        fit.run(1, 6, "fused", "mean", quiet)
        results.append(everything(fit))
    assert not moved(*results)


def test_gaussians_wait_for_the_networks(begin, recipe):
    fit = begin(last=15)  # starts at 1000 of the paper's 15,000: after iteration 1
    before = everything(fit)
    fit.run(1, 1, "sharp", "mean", quiet)
    assert not any("gaussians" in name for name in moved(before, everything(fit)))
    assert any("color" in name for name in moved(before, everything(fit)))
    fit.run(2, 2, "sharp", "mean", quiet)
    assert any("gaussians" in name for name in moved(before, everything(fit)))


def test_the_non_rigid_network_waits_for_the_skinning(begin):
    fit = begin(last=15)  # starts at 3000 of the paper's 15,000: after iteration 3
    before = everything(fit)
    fit.run(1, 3, "sharp", "mean", quiet)
    assert not any("deformation" in name for name in moved(before, everything(fit)))
    fit.run(4, 4, "sharp", "mean", quiet)
    assert any("deformation" in name for name in moved(before, everything(fit)))


def test_the_skinning_loss_weighs_a_hundredth_after_the_switch(begin, recipe):
    params = changed(recipe, "fitting.skinning", rate=1e-12, switch=5000)
    terms = []
    begin(params=params, last=6).run(1, 4, "sharp", "mean", lambda _, t: terms.append(t))
    early, late = terms[1]["skinning"], terms[2]["skinning"]
    assert late == pytest.approx(early / 100, rel=0.3)  # other samples


@pytest.mark.parametrize(
    ("motion", "unknown"),
    [("fixed", set()), ("frame", {"axis_angle", "transl"}),
     ("pair", {"start", "end", "start_transl", "end_transl"})],
)  # fmt: skip
def test_what_moves_is_what_is_unknown(begin, motion, unknown):
    fit = begin(motion=motion)
    before = everything(fit)
    supervision = "mean" if motion == "pair" else "sharp"
    fit.run(1, 2, supervision, "mean", quiet)
    names = {n.removeprefix("motion.") for n in moved(before, everything(fit)) if "motion" in n}
    assert names == unknown


def test_every_frame_is_visited_once_before_any_is_visited_again(begin, observations):
    fit = begin()
    count = len(observations.train)
    visits = [fit._next_frame() for _ in range(3 * count)]
    for turn in range(3):
        assert sorted(visits[turn * count : (turn + 1) * count]) == list(observations.train)
    assert visits[:count] != visits[count : 2 * count]


def test_frames_set_aside_and_frames_without_a_person_are_not_fitted(begin, sharpened):
    weights = torch.tensor([1.0, 0, 1, 1, 1])
    fit = begin(motion="frame", seen=sharpened(weights=weights))
    before = fit.trajectory.axis_angle.detach().clone()
    fit.run(1, 6, "sharp", "mean", quiet)
    still = (fit.trajectory.axis_angle == before).flatten(1).all(1)
    assert still.tolist() == [False, True, False, False, True]  # 4 is for validation


def test_frames_that_were_not_fitted_are_coloured_like_their_neighbours(begin, sharpened):
    fit = begin(seen=sharpened(train=(0, 1), validation=(3,)))
    fit.run(1, 2, "sharp", "mean", quiet)
    codes = fit.avatar.color_network.latents.weight
    assert not torch.equal(codes[0], codes[1])
    assert torch.equal(codes[2:], codes[1].expand(3, 2))


def test_a_black_mask_and_a_clip_without_a_person_are_refused(begin, sharpened, observations):
    mattes = observations.mattes.clone()
    mattes[2] = 0
    with pytest.raises(ArtifactError, match="frame 2 has a black mask; its weight should be 0"):
        begin(seen=sharpened(mattes=mattes))
    with pytest.raises(ArtifactError, match="no training frame shows a person"):
        begin(seen=sharpened(weights=torch.zeros(5)))


def memory(fit, name):
    tensors = fit.checkpoint(0).tensors
    return tensors[f"networks.{name}.exp_avg"]


def test_a_pair_with_equal_ends_is_pulled_alike_at_both_and_noise_tells_them_apart(begin):
    for noise in (0.0, 0.05):
        fit = begin(motion="pair", noise=noise, count=150)
        fit.step(1, "mean", "mean")
        recipe, end = memory(fit, "motion.start"), memory(fit, "motion.end")
        apart = (recipe - end).abs().max() / recipe.abs().max()
        assert apart < 1e-5 if noise == 0 else apart > 1e-3


@pytest.mark.parametrize("mask", ["mean", "centre"])
def test_a_still_body_does_not_blur(begin, mask):
    sharp = begin(motion="frame").step(1, "sharp", "mean")
    still = begin(motion="pair", noise=0.0).step(1, "mean", mask)
    assert still == pytest.approx(sharp, rel=1e-4)


def test_union_covers_more_than_the_mean(begin, recipe, sharpened):
    """Against an empty matte (but for one pixel) the mask's loss is what is covered."""
    mattes = torch.zeros(5, 24, 24, dtype=torch.uint8)
    mattes[:, 12, 12] = 1
    seen = sharpened(mattes=mattes)
    losses = {}
    for mask in ("centre", "mean", "union"):
        losses[mask] = begin(motion="pair", noise=0.5, seen=seen).step(1, "mean", mask)["mask"]
    assert losses["union"] > 1.2 * losses["mean"]
    assert losses["centre"] != losses["mean"]


def test_fusing_equal_renders_changes_nothing(begin):
    averaged = begin(motion="pair", noise=0.0).step(1, "mean", "mean")
    fused = begin(motion="pair", noise=0.0, fused=True).step(1, "fused", "mean")
    assert fused == pytest.approx(averaged, rel=1e-4)


def test_fusing_trains_the_fusion_network_and_both_renders(begin):
    fit = begin(motion="pair", fused=True)
    before = {name: value.detach().clone() for name, value in fit.fusion.named_parameters()}
    poses = everything(fit)
    fit.step(1, "fused", "mean")
    after = dict(fit.fusion.named_parameters())
    assert all(not torch.equal(before[name], after[name]) for name in before)
    assert {"motion.start", "motion.end"} <= moved(poses, everything(fit))


@pytest.mark.parametrize("motion", ["cubic", "learned", "released"])
def test_every_motion_of_an_exposure_learns_from_the_mean(begin, motion):
    fit = begin(motion=motion, last=100)
    before = everything(fit)
    for iteration in range(40, 46):
        fit.step(iteration, "mean", "mean")
    still = {"motion.given", "motion.given_transl"}
    unknown = {name for name in before if name.startswith("motion.")} - still
    assert unknown <= moved(before, everything(fit))


@pytest.mark.parametrize("fused", [False, True])
def test_the_released_code_compares_sharp_and_mean_then_sharp_and_fused(begin, fused):
    fit = begin(motion="released", fused=fused, last=150, noise=0.3)
    weights = {"sharp": 0.1, "fused": 1.0} if fused else {"sharp": 1.0, "mean": 1.0}
    seen = []
    compare = fit.objective.pictures
    fit.objective.pictures = lambda compared, *rest: (
        seen.append([one.share for one in compared]) or compare(compared, *rest)
    )
    fit._still = set()
    terms = fit.step(80 if fused else 40, "released", "union")
    assert seen == [list(weights.values())]
    assert all(value == value for value in terms.values())


def test_the_averaged_render_is_part_of_the_released_blend_without_gradient(begin, recipe):
    """Held to pictures alone, the pair inside an exposure has nothing to learn from then."""
    params = only(recipe, l1=1.0)

    def moved_by(supervision):
        fit = begin(params=params, motion="released", noise=0.3, fused=True, last=150)
        fit._still = set()
        before = everything(fit)
        fit.step(80, supervision, "union")
        return {name for name in moved(before, everything(fit)) if name.startswith("motion.")}

    assert moved_by("fused") == {
        "motion.start", "motion.end", "motion.start_transl", "motion.end_transl",
    }  # fmt: skip
    assert moved_by("released") == set()


def test_light_is_averaged_before_it_is_encoded(begin, sharpened):
    """The same avatar, taken to be linear, is brighter in sRGB; a black frame shows by how much."""
    black = torch.zeros(5, 24, 24, 3, dtype=torch.uint8)
    terms = {
        averaging_space: begin(
            motion="pair", seen=sharpened(frames=black, averaging_space=averaging_space)
        ).step(1, "mean", "mean")
        for averaging_space in ("srgb", "linear")
    }
    assert terms["linear"]["l1"] > 1.2 * terms["srgb"]["l1"]
    assert terms["linear"]["mask"] == pytest.approx(terms["srgb"]["mask"])


def test_network_gradients_are_clipped_together_and_poses_are_not(begin, recipe):
    params = changed(recipe, "fitting", max_norm=1e-3)
    fit = begin(params=params, motion="pair")
    fit.step(1, "mean", "mean")
    tensors = fit.checkpoint(1).tensors
    # Adam's first memory is a tenth of the first gradient (and of its decay).
    networks = [
        value / 0.1
        for name, value in tensors.items()
        if name.startswith("networks.network") and name.endswith("exp_avg")
        if "latents" not in name
    ]
    norm = torch.cat([value.flatten() for value in networks]).norm().item()
    assert norm == pytest.approx(1e-3, rel=0.05)
    assert tensors["networks.motion.start.exp_avg"].norm() / 0.1 > 2e-3


def each(fit, setting):
    """A setting of the optimisers by the unknown's name."""
    return {
        name: group[setting]
        for optimizer in fit.optimizers.all().values()
        for group in optimizer.param_groups
        for name in group["names"]
    }


def test_learning_rates_fall_as_the_papers_do(begin, recipe):
    fit = begin(motion="pair", fused=True, last=20)
    fit.step(20, "fused", "mean")
    rates = each(fit, "lr")
    base = recipe.fitting
    means = base.rates.means * base.rates.means_final
    assert rates["means"] == pytest.approx(means**0.5)
    assert rates["quats"] == base.rates.quats
    assert rates["network.nonrigid.last.weight"] == pytest.approx(0.1 * base.nonrigid.rate)
    assert rates["network.skinning.network.last.weight"] == pytest.approx(0.1 * base.skinning.rate)
    assert rates["motion.start"] == pytest.approx(0.1 * 1e-3)
    assert rates["motion.start_transl"] == pytest.approx(0.1 * 1e-4)
    assert rates["fusion.look.weight"] == FUSION.rate


def test_only_the_latent_codes_of_frames_decay(begin, recipe):
    fit = begin()
    decays = each(fit, "weight_decay")
    assert decays.pop("network.color.latents.weight") == recipe.fitting.color.latent_decay
    assert set(decays.values()) == {0.0}


def densifying(recipe):
    """Every step adds what is pulled at all; nothing is dropped."""
    return changed(
        without_densification(recipe), "fitting.densify", start=1, every=1, gradient=1e-12
    )


def without_densification(recipe):
    """No gradient is as large as that, no Gaussian as faint or as wide."""
    return changed(
        recipe,
        "fitting.densify",
        gradient=100.0,
        prune_opacity=0.0,
        prune_scale_m=100.0,
        max_growth=2.0,
    )


def test_gaussians_are_added_between_start_and_stop(begin, recipe):
    # From 5,000 to 10,000 of the paper's 15,000: after iteration 5 and before 10.
    params = changed(densifying(recipe), "fitting.densify", start=5000, max_growth=99.0)
    fit = begin(params=params, last=15)
    counts = []
    fit.run(1, 12, "sharp", "mean", lambda *_: counts.append(len(fit.avatar.gaussians)))
    assert counts[:5] == [80] * 5
    assert 80 < counts[5] < counts[6] < counts[7] < counts[8]
    assert counts[8:] == [counts[8]] * 4


def test_gaussians_are_added_up_to_the_cap(begin, recipe):
    fit = begin(params=densifying(recipe), last=15)
    fit.run(1, 5, "sharp", "mean", quiet)
    assert len(fit.avatar.gaussians) == 160


@pytest.fixture
def look_ups(monkeypatch):
    """Which look-ups have been made: of neighbours, and of places on the body."""
    made = []

    def watch(module, name):
        original = getattr(module, name)

        def watched(*arguments):
            made.append(name)
            return original(*arguments)

        monkeypatch.setattr(module, name, watched)

    watch(splats, "neighbour_indices")
    watch(splats, "surface_weights")
    return made


BOTH = ["neighbour_indices", "surface_weights"]


@pytest.fixture
def held_alike(plain_recipe):
    """An avatar that looks up both neighbours and places on the body, of a constant number."""
    params = changed(plain_recipe, "fitting.regularisers", smooth_colors=0.1)
    return without_densification(params)


def test_gaussians_are_looked_up_again_after_an_edit_even_if_their_number_is_the_same(
    begin, held_alike, look_ups
):
    params = changed(held_alike, "fitting.densify", start=1, every=2000)
    fit = begin(params=params, last=15)
    fit.run(1, 2, "sharp", "mean", quiet)  # the second step edits, and changes nothing
    assert sorted(look_ups) == BOTH
    fit.step(3, "sharp", "mean")
    assert sorted(look_ups) == sorted(2 * BOTH)


def test_gaussians_are_looked_up_again_every_hundred_steps(begin, held_alike, look_ups):
    fit = begin(params=held_alike, last=15_000)
    fit.run(98, 99, "sharp", "mean", quiet)
    assert sorted(look_ups) == BOTH
    fit.run(100, 101, "sharp", "mean", quiet)
    assert sorted(look_ups) == sorted(2 * BOTH)


def continued(fit, motion, checkpoint, seen, params, schedule):
    """A new fit that knows only what was saved, and where random draws stood."""
    model = avatar_from_artifact(fit.avatar.to_artifact(checkpoint.iteration), seen.body, CPU)
    generator = torch.Generator()
    generator.set_state(fit._generator.get_state())
    fitted = FitParams(recipe=params, motion=motion_of(motion.kind, 0.0), schedule=schedule)
    again = AvatarFit(model, trajectory_from_artifact(motion), seen, fitted, CPU, generator)
    again.restore(checkpoint)
    return again


HALF = LevelParams(until=0.66, size=0.5, gaussians=0.25, virtual_poses=3)


def test_pictures_and_avatar_grow_from_level_to_level(begin, schedule, plain_recipe):
    recipe = changed(without_densification(plain_recipe), "fitting.regularisers", smooth_colors=0.1)
    whole = schedule.gaussians
    fit = begin(params=recipe, motion="clip", last=9, levels=(HALF,), count=whole // 4)
    taken, sizes, counts = [], [], []
    render = fit.avatar.render

    def watched(state, transforms, camera, **options):
        taken.append(len(transforms))
        sizes.append((camera.width, camera.binning))
        return render(state, transforms, camera, **options)

    fit.avatar.render = watched
    fit.run(1, 9, "mean", "mean", lambda *_: counts.append(len(fit.avatar.gaussians)))
    assert taken == [3] * 6 + [5] * 3
    assert sizes == [(12, 2.0)] * 6 + [(24, 1.0)] * 3
    assert counts == [whole // 4] * 6 + [whole] * 3
    assert (
        fit.trajectory.to_artifact(fit.avatar.betas, torch.arange(5) / 30.0).num_samples.tolist()
        == [5] * 5
    )


@pytest.mark.parametrize("stopped", [98, 99, 100])
def test_a_fit_restored_beside_the_step_where_it_grows_goes_on_bit_for_bit(
    begin, recipe, schedule, sharpened, tmp_path, stopped
):
    seen = sharpened(train=(0, 1, 2))
    params = without_densification(recipe)
    fit = begin(params=params, motion="pair", seen=seen, last=150, count=20, levels=(HALF,))
    fit.run(1, stopped, "mean", "mean", quiet)
    fit.checkpoint(stopped).save(tmp_path / "checkpoint")
    motion = fit.trajectory.to_artifact(seen.poses.betas, seen.timestamps)
    checkpoint = Checkpoint.load(tmp_path / "checkpoint")
    again = continued(fit, motion, checkpoint, seen, params, paced(schedule, 150, (HALF,)))
    again._queue = list(fit._queue)
    for one in (fit, again):
        one.avatar.invalidate_neighbours()
        one.run(stopped + 1, 104, "mean", "mean", quiet)
    assert len(fit.avatar.gaussians) == schedule.gaussians
    assert not moved(everything(fit), everything(again))


@pytest.mark.parametrize("gain", ["none", "frame"])
def test_a_restored_fit_goes_on_bit_for_bit_as_the_uninterrupted_one(
    begin, recipe, schedule, sharpened, tmp_path, gain
):
    # Iteration 99 ends a round of three frames, and at 100 neighbours are looked up anyway: order
    # and neighbours are the two things that a checkpoint does not hold.
    seen = sharpened(train=(0, 1, 2))
    density = {"start": 9500, "every": 400, "stop": 15_000, "gradient": 1e-3, "max_growth": 99.0}
    params = changed(densifying(recipe), "fitting.densify", **density)
    params = params.model_copy(update={"exposure_gain": gain})
    fit = begin(params=params, motion="pair", seen=seen, last=150, count=60)
    fit.run(1, 99, "mean", "mean", quiet)
    count = len(fit.avatar.gaussians)
    fit.checkpoint(99).save(tmp_path / "checkpoint")
    motion = fit.trajectory.to_artifact(seen.poses.betas, seen.timestamps)
    again = continued(
        fit, motion, Checkpoint.load(tmp_path / "checkpoint"), seen, params, paced(schedule, 150)
    )
    assert not moved(everything(fit), everything(again))
    for one in (fit, again):
        one.run(100, 106, "mean", "mean", quiet)
    assert len(fit.avatar.gaussians) > count  # the densifier has gone on too
    assert not moved(everything(fit), everything(again))


def test_darker_frames_are_explained_by_a_gain_if_that_is_asked_for(begin, recipe, sharpened):
    seen = sharpened(train=(0, 1, 2))
    dim = seen.frames.clone()
    dim[0] = dim[0] // 2
    seen = dataclasses.replace(seen, frames=dim)
    misses = {}
    for gain in ("none", "frame"):
        params = without_densification(recipe).model_copy(update={"exposure_gain": gain})
        fit = begin(params=params, seen=seen, last=60)
        heard = []
        fit.run(1, 60, "sharp", "mean", lambda _, terms, heard=heard: heard.append(terms["l1"]))
        misses[gain] = sum(heard[-12:])
        found = fit.checkpoint(60).tensors.get("gains.found")
        assert (found is None) == (gain == "none")
    assert found is not None
    assert float(found[0]) < float(found[1]) - 0.4
    assert misses["frame"] < 0.97 * misses["none"]


def test_a_checkpoint_does_not_change_when_fitting_goes_on(begin, recipe):
    fit = begin(params=without_densification(recipe))
    fit.run(1, 3, "sharp", "mean", quiet)
    checkpoint = fit.checkpoint(3)
    before = {name: value.clone() for name, value in checkpoint.tensors.items()}
    other = begin(params=without_densification(recipe))
    other.restore(checkpoint)
    for one in (fit, other):
        one.run(4, 5, "sharp", "mean", quiet)
    assert all(torch.equal(value, before[name]) for name, value in checkpoint.tensors.items())


def test_a_checkpoint_of_another_avatar_is_refused(begin):
    with pytest.raises(ArtifactError, match="remembers 80 Gaussians, the avatar has 60"):
        begin(count=60).restore(begin().checkpoint(0))


def test_unknowns_that_are_new_start_without_memory(begin, recipe):
    params = without_densification(recipe)
    fixed, pair = begin(params=params), begin(params=params, motion="pair")
    fixed.run(1, 3, "sharp", "mean", quiet)
    pair.restore(fixed.checkpoint(3))
    tensors = pair.checkpoint(3).tensors
    assert not any("motion" in name for name in tensors)
    old = fixed.checkpoint(3).tensors
    assert tensors.keys() == old.keys()
    assert all(torch.equal(tensors[name], old[name]) for name in old)


def test_a_plain_avatar_at_fixed_poses_can_be_fitted_too(begin, plain_recipe):
    losses = []
    fit = begin(params=hurried(plain_recipe), count=150, last=60)
    fit.run(1, 60, "sharp", "mean", lambda _, terms: losses.append(terms["l1"]))
    assert sum(losses[-4:]) < 0.4 * sum(losses[:4])


def test_time_spent_is_told_in_seconds(begin):
    assert 0 < begin().run(1, 1, "sharp", "mean", quiet) < 60


def test_isometry_can_be_switched_off(begin, recipe):
    params = changed(recipe, "fitting.regularisers", isometry_means=0.0, isometry_covars=0.0)
    params = changed(params, "losses", structure=0.0)
    terms = begin(params=params).step(1, "sharp", "mean")
    assert set(terms) == {"l1", "mask", "skinning"}


WRIST = SMPL_JOINT_NAMES.index("left_wrist")


def rise(body, betas, first, last):
    """How far the left wrist rises between two poses (axis-angle of all joints, translation)."""
    joints = [posed_joints(body, betas, pose[0], pose[1:], shift) for pose, shift in (first, last)]
    return (joints[1] - joints[0])[WRIST, 1].item()


@pytest.mark.parametrize("noise", [0.05, 0.0])
def test_how_far_a_blurred_hand_has_moved_is_found_but_not_which_way_nor_without_noise(
    noise, body, painted, swinging, front, plain_recipe, observations
):
    size, last, ends = 48, 80 if noise > 0 else 30, swinging(2, 30.0)
    u = instants(16, "midpoints")[:, None]

    def between(share):
        body_pose = ends.body_pose[:1] + share[..., None] * ends.body_pose.diff(dim=0)
        transl = ends.transl[:1] + share * ends.transl.diff(dim=0)
        return dataclasses.replace(
            ends, global_orient=torch.zeros(len(share), 3), body_pose=body_pose, transl=transl
        )

    model, K = painted(2, count=600), front.Ks[0].clone()
    K[:2] *= size / 24
    camera = Camera(K, front.viewmats[0], size, size)
    image, alpha = render_avatar(model, between(u), camera, average=True)
    seen = dataclasses.replace(
        observations,
        frames=(255 * image).round().to(torch.uint8),
        mattes=(255 * alpha).round().to(torch.uint8),
        cameras=dataclasses.replace(front, Ks=K[None]),
        poses=between(torch.tensor([[0.5]])),
        weights=torch.ones(1), frame_indices=(0,), timestamps=torch.zeros(1), train=(0,),
        validation=(),
    )  # fmt: skip
    # The avatar is known; its motion is not.
    params = changed(plain_recipe, "fitting", gaussians_start=10**6)
    params = changed(params, "fitting.densify", start=15_000)
    moves = motion_of("pair", noise, rates={"poses": 0.02, "transl": 1e-3})
    generator = torch.Generator().manual_seed(0)
    motion = PairMotion(seen.poses, instants(5, "midpoints"), noise, generator)
    schedule = ScheduleParams(
        warmup=1, trajectory=2, fusion=last, gaussians=1, image_height=size, levels=()
    )
    fitted = FitParams(recipe=params, motion=moves, schedule=schedule)
    fit = AvatarFit(model, motion, seen, fitted, CPU, generator)
    fit.run(1, last, "mean", "mean", quiet)
    poses = torch.cat([ends.global_orient[:, None], ends.body_pose], 1)
    truth = rise(body, ends.betas, *zip(poses, ends.transl, strict=True))
    with torch.no_grad():
        first = motion.start[0], motion.start_transl[0]
        found = rise(body, ends.betas, first, (motion.end[0], motion.end_transl[0]))
    assert truth > 0.25  # metres
    if noise > 0:
        assert abs(found) == pytest.approx(truth, rel=0.1)
    else:
        assert abs(found) < 0.4 * truth  # still near the saddle


def test_what_no_picture_shows_takes_after_its_neighbours(begin, plain_recipe):
    def unlike_at_the_back(weight: float) -> float:
        params = changed(plain_recipe, "fitting.regularisers", smooth_colors=weight)
        params = changed(without_densification(params), "fitting.rates", features=0.1)
        fit = begin(params=params, last=60)
        features = fit.avatar.gaussians.features
        with torch.no_grad():
            features.copy_(torch.randn(features.shape, generator=seeded(4)))
        fit.run(1, 60, "sharp", "mean", quiet)
        apart = features[fit.avatar.neighbours()] - features[:, None]
        hidden = fit.avatar.gaussians.means[:, 2] < 0
        return float(apart[hidden].abs().mean().detach())

    assert unlike_at_the_back(0.1) < 0.7 * unlike_at_the_back(0.0)


def test_smoothness_is_weighted_and_counts_by_what_is_hidden(begin, plain_recipe, sharpened):
    weights = {"smooth_heights": 0.3, "smooth_shapes": 0.2, "smooth_colors": 0.1}
    params = changed(plain_recipe, "fitting.regularisers", **weights)
    terms = begin(params=params).step(1, "sharp", "mean")
    assert weights.keys() <= terms.keys()
    doubled = changed(params, "fitting.regularisers", smooth_heights=0.6)
    again = begin(params=doubled).step(1, "sharp", "mean")
    assert again["smooth_heights"] == pytest.approx(2 * terms["smooth_heights"], rel=1e-5)
    assert again["smooth_shapes"] == pytest.approx(terms["smooth_shapes"], rel=1e-5)
    shown = begin(params=params, seen=sharpened(occluded_fraction=0.25)).step(1, "sharp", "mean")
    assert shown["smooth_shapes"] == pytest.approx(terms["smooth_shapes"] / 4, rel=1e-5)


DEPTH = {"anchor": 0.0, "depth": 2.0}


def test_steps_towards_the_camera_are_held_back_and_steps_across_are_not(begin):
    fit = begin(motion="clip", priors=DEPTH)
    middle = len(fit.trajectory.transl) // 2

    def held_back(step: list[float]) -> float:
        with torch.no_grad():
            fit.trajectory.transl += torch.tensor(step)
            term = fit.objective.priors(2, fit.trajectory(2))["depth"]
            fit.trajectory.transl -= torch.tensor(step)
        return float(term)

    assert middle > 0
    assert held_back([0.0, 0.0, 0.0]) == pytest.approx(0.0, abs=1e-9)
    # The camera looks along z.
    assert held_back([0.03, 0.03, 0.0]) == pytest.approx(0.0, abs=1e-9)
    assert held_back([0.0, 0.0, 0.03]) == pytest.approx(2.0 * 0.1**2, rel=1e-4)


def test_depth_is_free_where_the_first_poses_do_not_know_it(begin, sharpened):
    fit = begin(motion="clip", priors=DEPTH, seen=sharpened(depth_known=False))
    with torch.no_grad():
        fit.trajectory.transl += 0.1
    assert "depth" not in fit.objective.priors(2, fit.trajectory(2))


def test_a_frame_that_is_trusted_less_counts_less(begin, recipe, sharpened, observations):
    half = sharpened(weights=torch.full_like(observations.weights, 0.5))
    whole, less = (begin(seen=seen).step(1, "sharp", "mean") for seen in (observations, half))
    for name in ("l1", "structure", "mask"):
        assert less[name] == pytest.approx(whole[name] / 2, rel=1e-6)
    assert less["skinning"] == pytest.approx(whole["skinning"], rel=1e-6)


def widened(seen, margin):
    """The same frames with so many black pixels around them."""
    around = (margin,) * 4
    K = seen.cameras.Ks.clone()
    K[:, :2, 2] += margin
    height, width = (side + 2 * margin for side in seen.frames.shape[1:3])
    pad = torch.nn.functional.pad
    return dataclasses.replace(
        seen,
        frames=pad(seen.frames, (0, 0, *around)),
        mattes=pad(seen.mattes, around),
        cameras=dataclasses.replace(
            seen.cameras, Ks=K, sizes=torch.tensor([[width, height]]).expand(len(K), 2).clone()
        ),
    )


def test_a_crop_changes_no_loss_of_a_mean_over_the_person(begin, plain_recipe, observations):
    wide = widened(observations, 12)
    for mean_over, alike in (("person", True), ("picture", False)):
        params = plain_recipe.model_copy(update={"mean_over": mean_over})
        near, far = (
            begin(params=params, seen=one).step(1, "sharp", "mean") for one in (observations, wide)
        )
        for name in ("l1", "mask"):
            # Not quite, where the person stands at the rim of so small a picture.
            same = near[name] == pytest.approx(far[name], rel=0.15)
            assert same == alike, name


def test_more_gaussians_move_in_smaller_steps(begin, plain_recipe, schedule):
    recipe = changed(plain_recipe, "fitting", rate_holds_to=schedule.gaussians)
    rates = {}
    for share in (1, 4):
        fit = begin(params=recipe, last=9)
        more = fit._params.schedule.model_copy(update={"gaussians": share * schedule.gaussians})
        fit.optimizers._schedule = more
        fit.optimizers.set_rates(5)
        groups = fit.optimizers.gaussians.param_groups
        rates[share] = {group["name"]: group["lr"] for group in groups}
    assert rates[4]["means"] == pytest.approx(rates[1]["means"] / 2)
    assert rates[4]["scales"] == rates[1]["scales"]
    assert recipe.fitting.pace_of_means(1) == 1  # fewer never move faster


def test_terms_of_two_devices_keep_their_names():
    here = {"a": torch.tensor(1.0), "b": torch.tensor(2.0)}
    names, values = _brought_together(here, torch.device("cpu"))
    assert dict(zip(names, values.tolist(), strict=True)) == {"a": 1.0, "b": 2.0}
    mixed = {
        "a": torch.tensor(1.0, device="meta"),
        **{"b": here["b"]},
        "c": torch.empty((), device="meta"),
    }
    names, values = _brought_together(mixed, torch.device("meta"))
    assert names == ["a", "c", "b"]
    assert values.shape == (3,)
    assert values.device.type == "meta"
