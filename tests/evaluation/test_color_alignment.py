import dataclasses

import torch

from deblur_avatar.evaluation.color_alignment import affine_map, color_aligned
from deblur_avatar.evaluation.comparisons import Comparison
from deblur_avatar.evaluation.truth_views import TruthView

SIZE = 24


def comparison(camera: int, gain, offset=0.0, seed: int = 0) -> Comparison:
    """A camera that sees a person of random colours by its own gains, who fills the middle."""
    generator = torch.Generator().manual_seed(seed)
    person = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    person[4:20, 4:20] = True
    colours = torch.rand(SIZE, SIZE, 3, generator=generator) * 0.6 * person[..., None]
    truth = (colours * torch.tensor(gain) + offset * person[..., None]).clamp(0, 1)
    image = (truth * 255).round().to(torch.uint8)
    view = TruthView(
        camera=camera, position=0, novel_pose=False, viewmat=None, offset=0.0, image=image,
        foreground=person, seen=person.clone(),
    )  # fmt: skip
    return Comparison(
        view=view,
        render=(colours * 255).round().to(torch.uint8),
        alpha=person.float(),
        difference=torch.zeros(SIZE, SIZE),
        scores={},
    )


def test_a_cameras_own_colours_cost_nothing_once_aligned():
    pink = comparison(1, (1.3, 0.9, 1.0), 0.05)
    (aligned,) = color_aligned([pink])
    assert aligned.scores["psnr_seen"] > 45
    assert aligned.render[0, 0].tolist() == [0, 0, 0]  # where nobody is stays black
    torch.testing.assert_close(
        affine_map([pink])[3], torch.tensor([0.05] * 3).double(), atol=0.003, rtol=0
    )


def test_every_camera_has_its_own_map():
    views = [comparison(1, (1.3, 0.9, 1.0)), comparison(2, (0.8, 1.0, 1.2), seed=1)]
    assert min(view.scores["psnr_seen"] for view in color_aligned(views)) > 45
    mixed = [dataclasses.replace(v, view=dataclasses.replace(v.view, camera=1)) for v in views]
    assert max(view.scores["psnr_seen"] for view in color_aligned(mixed)) < 35


def test_alignment_does_not_look_beyond_the_person():
    seen = comparison(1, (1.0, 1.0, 1.0))
    image = seen.view.image.clone()
    image[~seen.view.foreground] = 255  # another person, say
    disturbed = dataclasses.replace(seen, view=dataclasses.replace(seen.view, image=image))
    assert torch.equal(affine_map([seen]), affine_map([disturbed]))


def test_a_camera_without_a_person_keeps_its_colours():
    seen = comparison(1, (1.3, 1.0, 1.0))
    nobody = dataclasses.replace(seen.view, foreground=torch.zeros(SIZE, SIZE, dtype=torch.bool))
    found = affine_map([dataclasses.replace(seen, view=nobody)])
    assert torch.equal(found, torch.eye(4, 3).double())
