import numpy as np
import torch

from deblur_avatar.imaging.aligned_plates import align_frames, aligned_plates
from deblur_avatar.imaging.background_features import FrameFeatures
from deblur_avatar.imaging.matting import lift_person
from tests.imaging.moving_camera import FENCE, SIZE, filmed, wall_from_frame


def plates_of(frames, mattes):
    found = aligned_plates(frames, mattes, FrameFeatures(frames))
    return None if found is None else found[0]


def test_frames_are_aligned_to_less_than_a_pixel_at_the_corners():
    frames, mattes, _ = filmed()
    alignment = align_frames(FrameFeatures(frames), mattes)
    assert alignment is not None
    corners = np.array([[0, 0, 1], [SIZE[0], 0, 1], [0, SIZE[1], 1], [*SIZE, 1]], float).T
    for index in (5, 15):
        found = np.linalg.inv(alignment.mosaic_from_frame[0]) @ alignment.mosaic_from_frame[index]
        true = np.linalg.inv(wall_from_frame(0)) @ wall_from_frame(index)
        there, wanted = found @ corners, true @ corners
        apart = there[:2] / there[2] - wanted[:2] / wanted[2]
        assert np.abs(apart).max() < 0.9


def test_the_background_of_a_moving_camera_is_known_behind_the_person():
    frames, mattes, behind = filmed()
    plates = plates_of(frames, mattes)
    assert plates is not None
    edges = [(matte > 12) & (matte < 243) for matte in mattes]
    known = [plate.known[edge].float().mean() for plate, edge in zip(plates, edges, strict=True)]
    assert float(torch.stack(known).mean()) > 0.8
    apart = [
        (plate.picture.float() - true.float()).abs().mean(-1)[edge & plate.known]
        for plate, true, edge in zip(plates, behind, edges, strict=True)
    ]
    assert float(torch.cat(apart).mean()) < 8  # of 255; a wall of corners, resampled twice


def test_a_person_is_lifted_off_a_moving_background():
    frames, mattes, _ = filmed()
    plates = plates_of(frames, mattes)
    assert plates is not None
    lifted = lift_person(frames, mattes, plates, "srgb").float()
    truth = mattes[..., None] / 255 * torch.tensor([30.0, 200.0, 60.0])
    by_matte = frames.float() * mattes[..., None] / 255
    soft = (mattes > 12) & (mattes < 243) & torch.stack([plate.known for plate in plates])
    with_plate = (lifted - truth).abs()[soft].mean()
    without = (by_matte - truth).abs()[soft].mean()
    assert with_plate < 0.4 * without


def test_where_something_nearer_passes_less_is_taken_for_background():
    frames, mattes, behind = filmed(parallax=9.0)
    plates = plates_of(frames, mattes)
    assert plates is not None
    wrong = []
    for plate, true in zip(plates, behind, strict=True):
        apart = (plate.picture.float() - true.float()).abs().mean(-1)
        wrong.append((apart > 40)[plate.known].float().mean())
    assert float(torch.stack(wrong).mean()) < 0.05
    left = torch.stack([plate.known[:, : FENCE - 5] for plate in plates]).float().mean()
    right = torch.stack([plate.known[:, FENCE + 10 :] for plate in plates]).float().mean()
    assert left < 0.5 * right


def test_a_blank_wall_cannot_be_aligned():
    frames, mattes, _ = filmed(4)
    assert plates_of(torch.full_like(frames, 128), mattes) is None


def test_frames_of_different_places_cannot_be_aligned():
    frames, mattes, _ = filmed(4)
    frames[2:] = torch.from_numpy(np.random.default_rng(3).integers(0, 255, frames[2:].shape))
    assert plates_of(frames, mattes) is None


def test_the_same_frames_give_the_same_plates():
    frames, mattes, _ = filmed(6)
    first, second = plates_of(frames, mattes), plates_of(frames, mattes)
    assert first is not None
    assert second is not None
    assert all(torch.equal(a.picture, b.picture) for a, b in zip(first, second, strict=True))
