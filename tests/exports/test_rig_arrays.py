"""The rig as arrays poses itself in a few lines of numpy, without this project."""

import numpy as np
from scipy.spatial.transform import Rotation

from deblur_avatar.config.reading import parse
from deblur_avatar.exports.posed_gaussians import posed_gaussians
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.exports.shown_motion import shown_motions

MOTIONS = ("own", "builtin:jumping_jacks")


def posed_means(a, motion, frame):
    """What docs/exports.md tells a reader to do."""
    local = Rotation.from_quat(a[f"{motion}_quats"][frame], scalar_first=True).as_matrix()
    turned, places = [], []
    for joint, parent in enumerate(a["parents"]):
        offset = a["joints"][joint] - (a["joints"][parent] if parent >= 0 else 0)
        above = turned[parent] if parent >= 0 else np.eye(3)
        places.append((places[parent] if parent >= 0 else 0) + above @ offset)
        turned.append(above @ local[joint])
    posed_from_rest = np.tile(np.eye(4), (len(turned), 1, 1))
    posed_from_rest[:, :3, :3] = turned
    posed_from_rest[:, :3, 3] = [
        p - R @ j for p, R, j in zip(places, turned, a["joints"], strict=True)
    ] + a[f"{motion}_transl"][frame]
    blended = np.einsum("nj,jrc->nrc", a["lbs_weights"], posed_from_rest @ a["rest_from_canonical"])
    return (blended[:, :3, :3] @ a["means"][..., None])[..., 0] + blended[:, :3, 3]


def test_ten_lines_of_numpy_pose_the_avatar_as_we_do(rough, fitted_run, tmp_path):
    model = rough()
    run = fitted_run(model)
    options = {"format": "rig_arrays", "motions": list(MOTIONS), "fps": 30.0, "seconds": 1.0}
    parse(ExportParams, options, "export").export(run, tmp_path / "rig.npz")
    with np.load(tmp_path / "rig.npz", allow_pickle=False) as arrays:
        read = dict(arrays)
    assert str(read["licence"]) == run.observations.body.licence
    assert str(read["averaging_space"]) == "srgb"
    for motion in shown_motions(run, MOTIONS, 30.0, 1.0):
        for frame in (0, 3):
            viewmat = run.observations.camera.viewmat
            wanted = posed_gaussians(model, motion.poses.at([frame]), viewmat)
            found = posed_means(read, motion.name, frame)
            np.testing.assert_allclose(found, wanted.means, atol=2e-6)
    np.testing.assert_allclose(read["opacities"], wanted.opacities, atol=1e-6)
    np.testing.assert_allclose(read["colors"], wanted.colors, atol=1e-6)
