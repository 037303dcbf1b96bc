"""Steps to the ceiling: what place, pose and the avatar itself have of what is missing.

    python -m benchmarks.gap_steps SCENE... [--json FILE]

renders the test views of cells of the proof once more, each avatar as it was `fitted`, then
`placed` (the whole body moved rigidly so that its joints of this instant lie nearest the true ones:
what one camera cannot know of place and depth), then in the true `poses`, and in true poses with
the picture `shifted` by up to two pixels (an avatar that stands beside its skeleton). Prints JSON:
PSNR over the seen surface, dB, of each. What true poses leave of the gap to `ceiling` was learned
wrong while poses were wrong. Needs `make proof`; a minute a scene, no fit.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample

from benchmarks.record import print_record
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.bodies.posed_body import posed, shaped_joints
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.comparisons import compare, pose_of_view, true_poses
from deblur_avatar.evaluation.registration import similarity
from deblur_avatar.evaluation.truth_views import TruthView, truth_views
from deblur_avatar.imaging import metrics
from deblur_avatar.sources.given_poses import before_still_camera

DATA = Path("experiments/proof/data")
CELLS = ("plain-clip", "plain-oracle_clip", "plain-ceiling")
REACH, STEP = 2.0, 0.25  # pixels by which a picture is shifted, to each side


@dataclass(frozen=True)
class Cell:
    """An avatar in a scene whose true poses are known."""

    model: AvatarModel
    motion: Motion
    observations: Observations
    reference: Reference
    true: Poses

    @classmethod
    def of(
        cls, avatar: Avatar, motion: Motion, observations: Observations, reference: Reference
    ) -> "Cell":
        """Ready to be rendered.

        Raises:
            ArtifactError: if true poses are not known.
        """
        true = true_poses(observations, reference)
        if true is None:
            raise ArtifactError("this scene knows no true poses; those of the studio do")
        model = avatar_from_artifact(avatar, observations.body, torch.device("cpu"))
        return cls(model, motion, observations, reference, true)

    def steps(self) -> dict[str, float]:
        """Mean PSNR over the seen surface of the novel views, dB, one step truer each time."""
        found: dict[str, list[float]] = {"fitted": [], "placed": [], "poses": [], "shifted": []}
        for view in truth_views(self.observations, self.reference):
            if not view.novel_pose:
                for name, value in self._of_view(view).items():
                    found[name].append(value)
        return {name: round(sum(values) / len(values), 3) for name, values in found.items()}

    def _of_view(self, view: TruthView) -> dict[str, float]:
        fitted = pose_of_view(self.observations, self.motion, view)
        true = self.true.at([view.position])
        truer = {
            "fitted": fitted,
            "placed": placed(self.observations.body, fitted, true),
            "poses": replace(true, betas=self.model.betas.detach().cpu()),
        }
        seen = {
            name: compare(self.model, self.observations, self.reference, view, pose)
            for name, pose in truer.items()
        }
        picture = seen["poses"].render.float() / 255
        best = max(psnr_seen(shift, view) for shift in shifts(picture))
        return {name: one.scores["psnr_seen"] for name, one in seen.items()} | {"shifted": best}


def placed(body: Body, fitted: Poses, true: Poses) -> Poses:
    """A pose moved rigidly, so that its joints are nearest the true ones; sizes stay."""
    found, wanted = (posed(body, pose).joints[0].double() for pose in (fitted, true))
    move = torch.eye(4)
    turn = similarity(found, wanted).turn
    move[:3, :3], move[:3, 3] = turn, wanted.mean(0) - turn @ found.mean(0)
    return before_still_camera(fitted, move[None], shaped_joints(body, fitted.betas)[0])


def psnr_seen(picture: Float[Tensor, "H W 3"], view: TruthView) -> float:
    """Over the surface that the training camera saw, dB."""
    return float(metrics.psnr(picture[None], view.image[None].float() / 255, view.seen[None]))


def shifts(picture: Float[Tensor, "H W 3"]) -> list[Float[Tensor, "H W 3"]]:
    """The picture, moved by every step within reach, by none among them."""
    height, width = picture.shape[:2]
    ways = torch.arange(-REACH, REACH + STEP / 2, STEP)
    layers = picture.permute(2, 0, 1)[None]
    moved = []
    for down in ways:
        for right in ways:
            way = torch.tensor([[[1, 0, 2 * right / width], [0, 1, 2 * down / height]]])
            grid = affine_grid(way, [*layers.shape], align_corners=False)
            there = grid_sample(layers, grid, align_corners=False, padding_mode="border")
            moved.append(there[0].permute(1, 2, 0))
    return moved


def table(scenes: Sequence[str], data: Path) -> Mapping[str, Mapping[str, dict[str, float]]]:
    """Steps of every cell, by scene."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for scene in scenes:
        observations = Observations.load(data / scene / "preprocess" / "blurred")
        reference = Reference.load(data / scene / "clip" / "reference")
        found[scene] = {}
        for name in CELLS:
            folder = data / scene / "fusion" / f"{name}-x2-seed_0"
            avatar, motion = Avatar.load(folder / "avatar"), Motion.load(folder / "motion")
            found[scene][name] = Cell.of(avatar, motion, observations, reference).steps()
    return found


def main() -> None:
    """Render, score, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="+", help="of the proof")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    print_record(table(options.scenes, options.data), options.json)


if __name__ == "__main__":
    main()
