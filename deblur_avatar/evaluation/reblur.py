"""Re-blur PSNR: renders averaged over each exposure against the blurred frames.

Frames set aside for validation were not fitted. Where a trajectory does not know such frames
(`knows_unfitted`), their motion is interpolated from the fitted frames before and after.
"""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.render import as_filmed, render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.instants import between, exposure_of, joints_apart
from deblur_avatar.imaging.metrics import psnr
from deblur_avatar.motion.kinds import kind_of


def reblur(
    model: AvatarModel, observations: Observations, motion: Motion
) -> dict[str, float | None]:
    """Score averaged renders of the training camera against the frames it took.

    Returns:
        `psnr` over the frames set aside for validation (None without any) and `psnr_train` over
        those trained on, dB, all pixels whose colours can be compared; data range 1, sRGB.
    """

    def mean(positions: Sequence[int]) -> float | None:
        return mean_reblur_psnr(model, observations, motion, positions)

    return {"psnr": mean(observations.validation), "psnr_train": mean(observations.train)}


def mean_reblur_psnr(
    model: AvatarModel, observations: Observations, motion: Motion, positions: Sequence[int]
) -> float | None:
    """PSNR of averaged renders against the frames at some positions, dB; None for no position."""

    def score(position: int) -> float:
        image = as_filmed(observations, position, *reblurred(model, observations, motion, position))
        frame = observations.frames[position].float() / 255
        pair = [observations.comparable_part(p, position) for p in (image, frame)]
        return float(psnr(pair[0][None], pair[1][None]))

    return sum(map(score, positions)) / len(positions) if positions else None


def reblurred(
    model: AvatarModel, observations: Observations, motion: Motion, position: int
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W"]]:
    """The averaged render of one exposure on black, sRGB in [0, 1], and its coverage."""
    nearest = min(observations.train, key=lambda index: abs(index - position))
    image, alpha = render_avatar(
        model,
        poses_of_exposure(observations.body, motion, position, observations.train),
        observations.camera,
        frame=nearest,
        average=True,
    )
    return image[0].cpu(), alpha[0].cpu()


def poses_of_exposure(body: Body, motion: Motion, position: int, train: Sequence[int]) -> Poses:
    """The instants of one exposure, as far as a motion knows them.

    Between two fitted frames each instant turns along the shortest arcs. Their directions of time
    are arbitrary where each frame was fitted for itself: the second frame's is reversed if that
    brings its joints nearer to the first's.
    """
    if kind_of(motion).knows_unfitted or position in train:
        return exposure_of(motion, position)
    before = [index for index in train if index < position]
    after = [index for index in train if index > position]
    if not before or not after:
        return exposure_of(motion, before[-1] if before else after[0])
    start, end = exposure_of(motion, before[-1]), exposure_of(motion, after[0])
    backward = end.at(list(reversed(range(len(end.transl)))))
    here = posed(body, start).joints
    if joints_apart(here, posed(body, backward).joints) < joints_apart(
        here, posed(body, end).joints
    ):
        end = backward
    return between(start, end, (position - before[-1]) / (after[0] - before[-1]))
