import dataclasses

import numpy as np
import pytest
import torch
import trimesh

from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.posed_gaussians import axes_of
from deblur_avatar.exports.registry import EXPORTERS, ExportParams
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.motion.frame import FixedMotion
from deblur_avatar.rendering.covariances import covariances
from deblur_avatar.rendering.rasterize import rasterize

C0 = 0.5 / np.sqrt(np.pi)
SIZE = 96


def run_of(model, observations, poses) -> FittedRun:
    motion = FixedMotion(poses).to_artifact(poses.betas, observations.timestamps)
    return FittedRun("capsules-lean", model.to_artifact(1), motion, observations)


def read_splats(path):
    """Another program's reader of PLY, then the formulas of 3D Gaussian splatting's viewers."""
    table = trimesh.load(path).metadata["_ply_raw"]["vertex"]["data"]
    column = {name: torch.from_numpy(table[name].reshape(-1).copy()) for name in table.dtype.names}

    def columns(*names):
        return torch.stack([column[name] for name in names], 1)

    quats = columns("rot_0", "rot_1", "rot_2", "rot_3")
    return {
        "means": columns("x", "y", "z"),
        "covars": covariances(quats, columns("scale_0", "scale_1", "scale_2").exp()),
        "opacities": column["opacity"].sigmoid(),
        "colors": 0.5 + C0 * columns("f_dc_0", "f_dc_1", "f_dc_2"),
    }


def psnr(a, b):
    return float(-10 * (a - b).square().mean().log10())


@pytest.mark.parametrize("frame", [0, 3])
def test_another_programs_picture_of_the_file_is_the_avatars(
    painted, observations, swinging, body, front, tmp_path, frame
):
    model, poses = painted(count=600), swinging(5, 35.0)  # a shoulder whose blended skin stretches
    path = tmp_path / "pose.ply"
    exporter = parse(ExportParams, {"format": "ply", "frame": frame}, "export")
    run = run_of(model, observations, poses)
    exporter.export(run, path)
    splats = read_splats(path)
    assert len(splats["means"]) == 600
    K, viewmat = front.Ks[0].clone(), front.viewmats[0]
    K[:2] *= SIZE / 24
    axes = upright_of(run).for_splats()  # the same camera, in the file's axes
    camera_from_file = viewmat.clone()
    camera_from_file[:3, :3] = viewmat[:3, :3] @ axes.rotation.T
    camera_from_file[:3, 3] += viewmat[:3, :3] @ axes.origin
    ours, _ = render_avatar(model, poses.at([frame]), Camera(K, viewmat, SIZE, SIZE))
    theirs = rasterize(
        splats["means"][None], splats["covars"], splats["opacities"], splats["colors"],
        camera_from_file, K,
        SIZE, SIZE,
    )  # fmt: skip
    assert ours.amax() > 0.5
    assert psnr(theirs.image.clamp(0, 1), ours) >= 50
    other, _ = render_avatar(model, poses.at([4 - frame]), Camera(K, viewmat, SIZE, SIZE))
    assert psnr(theirs.image.clamp(0, 1), other) < 30


def test_a_viewer_with_y_down_sees_the_person_upright(painted, observations, swinging, tmp_path):
    run = run_of(painted(count=600), observations, swinging(5, 8.0))
    parse(ExportParams, {"format": "ply", "frame": 0}, "export").export(run, tmp_path / "a.ply")
    low, high = read_splats(tmp_path / "a.ply")["means"][:, 1].aminmax()
    assert -2.1 < float(low) < -1.4  # the head
    assert -0.1 < float(high) < 0.2  # the feet
    assert "part of deblur-avatar" in (tmp_path / "a.ply").read_bytes()[:200].decode("latin1")


def test_a_sequence_is_one_file_a_frame(painted, observations, swinging, tmp_path):
    run = run_of(painted(), observations, swinging(5, 8.0))
    options = {"format": "ply_sequence", "motion": "own", "fps": 30.0, "seconds": 1.0}
    parse(ExportParams, options, "export").export(run, tmp_path / "clip")
    files = sorted((tmp_path / "clip").iterdir())
    assert [file.name for file in files] == [f"frame_{index:04d}.ply" for index in range(5)]
    for frame in (0, 4):
        one = parse(ExportParams, {"format": "ply", "frame": frame}, "export")
        one.export(run, tmp_path / "one.ply")
        torch.testing.assert_close(
            read_splats(files[frame])["means"],
            read_splats(tmp_path / "one.ply")["means"], atol=1e-5, rtol=0,
        )  # fmt: skip


def test_colours_that_are_averaged_as_light_are_written_as_srgb(
    painted, observations, swinging, tmp_path
):
    poses = swinging(5, 8.0)
    read = {}
    for averaging_space in ("srgb", "linear"):
        exporter = parse(ExportParams, {"format": "ply", "frame": 0}, "export")
        exporter.export(
            run_of(painted(averaging_space=averaging_space), observations, poses),
            tmp_path / "pose.ply",
        )
        read[averaging_space] = read_splats(tmp_path / "pose.ply")["colors"]
    linear = read["srgb"].double()
    srgb = torch.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp(min=1e-9) ** (1 / 2.4) - 0.055
    )
    torch.testing.assert_close(read["linear"].double(), srgb, atol=1e-5, rtol=0)


def test_axes_are_right_handed_and_give_the_covariance_back():
    generator = torch.Generator().manual_seed(0)
    factors = torch.randn(50, 3, 3, generator=generator)
    factors[0] = torch.diag(torch.tensor([0.0, 1.0, 2.0]))  # flat
    factors[1] = torch.eye(3)  # round
    covars = factors @ factors.mT
    quats, scales = axes_of(covars)
    torch.testing.assert_close(quats.norm(dim=1), torch.ones(50))
    assert bool((scales > 0).all())
    torch.testing.assert_close(covariances(quats, scales), covars, atol=2e-5, rtol=1e-5)


def test_the_same_avatar_gives_the_same_bytes(painted, observations, swinging, tmp_path):
    exporter = parse(ExportParams, {"format": "ply", "frame": 1}, "export")
    for name in ("a.ply", "b.ply"):
        exporter.export(run_of(painted(), observations, swinging(5, 8.0)), tmp_path / name)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_what_cannot_be_written_is_refused(painted, observations, swinging, tmp_path):
    run = run_of(painted(), observations, swinging(5, 8.0))
    with pytest.raises(ConfigError, match="frame 5 of 5; frames are counted from 0 to 4"):
        parse(ExportParams, {"format": "ply", "frame": 5}, "export").export(run, tmp_path / "a.ply")
    exporter = parse(ExportParams, {"format": "ply", "frame": 0}, "export")
    (tmp_path / "file").touch()
    with pytest.raises(ArtifactError, match="cannot write"):
        exporter.export(run, tmp_path / "file" / "a.ply")
    with pytest.raises(
        ConfigError, match="no format of this name, there is " + ", ".join(EXPORTERS)
    ):
        parse(ExportParams, {"format": "obj"}, "export")


def test_opaque_gaussians_have_finite_logits(painted, observations, swinging, tmp_path):
    model: AvatarModel = painted()
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(40.0)
    run = run_of(model, observations, swinging(5, 8.0))
    run = dataclasses.replace(run, avatar=model.to_artifact(1))
    parse(ExportParams, {"format": "ply", "frame": 0}, "export").export(run, tmp_path / "a.ply")
    opacities = read_splats(tmp_path / "a.ply")["opacities"]
    assert bool(opacities.isfinite().all())
    assert float(opacities.min()) > 0.999
