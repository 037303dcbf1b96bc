import dataclasses

import pytest
import torch

from deblur_avatar.body_estimation.landmark_track import (
    ARMS,
    LEGS,
    MIRRORED,
    CleanTrack,
    clean,
    size_in_pictures,
    trust,
)
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks
from deblur_avatar.body_estimation.pace import pace_of

FRAMES = 20
PACE = pace_of(torch.arange(FRAMES) / 25)


@pytest.fixture
def walker() -> Landmarks:
    """600 pixels tall, all landmarks wander with sides 40 to 100 pixels apart."""
    time = torch.arange(FRAMES)[:, None]
    mark = torch.arange(COUNT)[None]
    side = torch.where(mark % 2 == 1, 1.0, -1.0) * (20 + mark)
    x = 500 + 4 * time + side + 10 * torch.sin(0.4 * time + mark)
    y = 100 + 600 * mark / (COUNT - 1) + 5 * torch.cos(0.5 * time + mark)
    points = torch.stack([x, y.expand_as(x)], dim=-1)
    return Landmarks(
        found=torch.ones(FRAMES, dtype=torch.bool),
        points=points,
        visibility=torch.full((FRAMES, COUNT), 0.9),
        mattes=torch.zeros(FRAMES, 2, 2, dtype=torch.uint8),
        world=torch.cat([points / 350, 0 * points[..., :1]], dim=-1),
    )


def cleaned(person: Landmarks) -> CleanTrack:
    return clean(person, PACE, size_in_pictures([person], any_pose=False), any_pose=False)


def changed(person: Landmarks, frames, marks, points) -> Landmarks:
    moved = person.points.clone()
    moved[frames, marks] = points
    return dataclasses.replace(person, points=moved)


def test_what_is_right_stays_as_it_is(walker: Landmarks):
    track = cleaned(walker)
    assert track.flags.counts() == {"swapped": 0, "jumped": 0, "lost": 0}
    torch.testing.assert_close(track.person.points, walker.points, rtol=0, atol=1e-3)
    assert torch.equal(track.person.visibility, walker.visibility)


@pytest.mark.parametrize("group", [ARMS, LEGS], ids=["arms", "legs"])
def test_exchanged_sides_are_put_right(walker: Landmarks, group: tuple[int, ...]):
    marks, frames = list(group), slice(8, 12)
    points, world = walker.points.clone(), walker.world.clone()
    mirrored = [MIRRORED[mark] for mark in marks]
    points[frames, marks] = walker.points[frames, mirrored]
    world[frames, marks] = walker.world[frames, mirrored]
    track = cleaned(dataclasses.replace(walker, points=points, world=world))
    assert track.flags.swapped.any(1).nonzero().flatten().tolist() == [8, 9, 10, 11]
    assert track.flags.counts()["jumped"] == 0
    torch.testing.assert_close(track.person.points, walker.points, rtol=0, atol=1e-3)
    torch.testing.assert_close(track.person.world, walker.world, rtol=0, atol=1e-4)


def test_a_jump_there_and_back_is_flagged_and_bridged(walker: Landmarks):
    away = walker.points[9, 15] + torch.tensor([250.0, -200])
    track = cleaned(changed(walker, 9, 15, away))
    assert track.flags.jumped.nonzero().tolist() == [[9, 15]]
    assert track.person.visibility[9, 15] == 0
    assert (track.person.points[9, 15] - walker.points[9, 15]).norm() < 5


def test_two_wrong_frames_in_a_row_are_flagged(walker: Landmarks):
    away = walker.points[9:11, 16] + torch.tensor([-300.0, 0])
    track = cleaned(changed(walker, slice(9, 11), 16, away))
    assert track.flags.jumped.nonzero().tolist() == [[9, 16], [10, 16]]


def test_a_real_kick_is_no_jump(walker: Landmarks):
    points = walker.points.clone()
    kick = torch.tensor([0, 40, 110, 190, 260, 300, 310, 300, 260, 190, 110, 40, 0.0])
    points[4:17, 28, 1] -= kick
    track = cleaned(dataclasses.replace(walker, points=points))
    assert track.flags.counts()["jumped"] == 0


def test_what_is_hardly_seen_is_lost_and_filled_in(walker: Landmarks):
    visibility = walker.visibility.clone()
    visibility[5:8, 27] = 0.1
    noisy = changed(walker, slice(5, 8), 27, torch.tensor([0.0, 0.0]))
    track = cleaned(dataclasses.replace(noisy, visibility=visibility))
    assert track.flags.lost.nonzero().tolist() == [[5, 27], [6, 27], [7, 27]]
    assert (track.person.points[5:8, 27] - walker.points[5:8, 27]).norm(dim=-1).max() < 12
    assert trust(track.flags, (26, 27)).tolist() == [1.0] * 5 + [0.5] * 3 + [1.0] * 12


def test_frames_without_a_person_are_lost(walker: Landmarks):
    found = walker.found.clone()
    found[3] = False
    points = walker.points.clone()
    points[3] = 0
    track = cleaned(dataclasses.replace(walker, found=found, points=points))
    assert track.flags.lost[3].all()
    assert (track.person.points[3] - walker.points[3]).norm(dim=-1).max() < 8


def test_a_clip_without_anyone_is_no_error(walker: Landmarks):
    nobody = dataclasses.replace(
        walker, found=torch.zeros(FRAMES, dtype=torch.bool), points=0 * walker.points
    )
    assert cleaned(nobody).flags.lost.all()


def test_who_lies_is_as_large_as_who_stands(walker: Landmarks):
    lying = dataclasses.replace(walker, points=walker.points.flip(-1))
    heights = [size_in_pictures([person], any_pose=False) for person in (walker, lying)]
    sizes = [size_in_pictures([person], any_pose=True) for person in (walker, lying)]
    assert heights[0] == sizes[0] == sizes[1] > 4 * heights[1] > 0
    both = size_in_pictures([walker, lying, lying], any_pose=False)
    assert both == pytest.approx(heights[1], rel=0.05)
    nobody = dataclasses.replace(walker, found=torch.zeros(FRAMES, dtype=torch.bool))
    assert size_in_pictures([nobody], any_pose=True) == 1.0


def test_fast_is_by_the_size_that_is_given(walker: Landmarks):
    """Who lies moves no faster for being short: what is a jump of a height is none of a length."""
    away = walker.points[9, 15] + torch.tensor([250.0, -200])
    moved = changed(walker, 9, 15, away)
    assert clean(moved, PACE, 600.0, any_pose=False).flags.jumped.any()
    assert not clean(moved, PACE, 3000.0, any_pose=False).flags.jumped.any()


def test_a_gap_in_time_is_no_jump_and_what_is_lost_in_it_lies_on_the_way(walker: Landmarks):
    """She went on in the frames that are missing, by most of her height in a fifth of a second."""
    times = torch.arange(FRAMES) / 25
    times[17:] += 0.2
    points, lost = walker.points.clone(), walker.visibility.clone()
    points[17:, :, 0] += 500
    lost[17] = 0
    gone_on = dataclasses.replace(walker, points=points, visibility=lost)
    track = clean(gone_on, pace_of(times), 600.0, any_pose=False)
    assert not track.flags.jumped.any()
    assert clean(gone_on, PACE, 600.0, any_pose=False).flags.jumped.any()
    last, filled, first = track.person.points[16:19]
    torch.testing.assert_close(filled, last + (first - last) * 6 / 7, rtol=0, atol=0.01)


@pytest.mark.parametrize("any_pose", [False, True])
def test_what_is_lost_beyond_the_picture_is_guessed_in_any_pose(walker: Landmarks, any_pose: bool):
    """Legs below the picture's edge, one of them seen in one frame, by mistake, where an arm is."""
    visibility, points, world = (
        value.clone() for value in (walker.visibility, walker.points, walker.world)
    )
    visibility[:, LEGS] = 0.1
    visibility[8, 25] = 0.8
    points[8, 25], world[8, 25] = torch.tensor([500.0, 200.0]), torch.tensor([0.4, -0.5, 0.0])
    person = dataclasses.replace(
        walker, points=points, visibility=visibility, world=world,
        mattes=torch.zeros(FRAMES, 450, 900, dtype=torch.uint8), found=torch.arange(FRAMES) != 3,
    )  # fmt: skip
    track = clean(person, PACE, 600.0, any_pose=any_pose).person
    assert (points[:, 27, 1] > 450).all()
    if any_pose:
        torch.testing.assert_close(track.points[9:, 25], points[9:, 25], rtol=0, atol=1e-3)
        torch.testing.assert_close(track.world[9:, 25], world[9:, 25], rtol=0, atol=1e-5)
        assert not torch.equal(track.points[3, 25], points[3, 25])  # nobody was found there
    else:
        assert (track.points[:, 25] - points[8, 25]).abs().max() < 1e-3
    assert torch.equal(track.visibility[9:], visibility[9:])


def test_what_is_lost_in_the_picture_lies_between_where_it_was_seen_in_any_pose(walker: Landmarks):
    hidden = walker.visibility.clone()
    hidden[6:14, 15] = 0.1
    person = dataclasses.replace(
        walker, visibility=hidden, mattes=torch.zeros(FRAMES, 900, 900, dtype=torch.uint8)
    )
    points = [clean(person, PACE, 600.0, any_pose=kind).person.points for kind in (False, True)]
    assert torch.equal(*points)
    assert not torch.allclose(points[0][10, 15], walker.points[10, 15], atol=0.1)


@pytest.mark.parametrize("edge", ["left", "top", "right", "bottom"])
def test_every_edge_of_the_picture_is_one(walker: Landmarks, edge: str):
    lost = walker.visibility.clone()
    lost[10, 15] = 0.1
    away = {"left": (-1.0, 300.0), "top": (400.0, -1.0), "right": (900.0, 300.0),
            "bottom": (400.0, 800.0)}[edge]  # fmt: skip
    person = dataclasses.replace(
        changed(walker, 10, 15, torch.tensor(away)), visibility=lost,
        mattes=torch.zeros(FRAMES, 800, 900, dtype=torch.uint8),
    )  # fmt: skip
    found = clean(person, PACE, 600.0, any_pose=True).person.points[10, 15]
    torch.testing.assert_close(found, torch.tensor(away), rtol=0, atol=1e-3)


def test_a_jump_beyond_the_picture_is_a_mistake_in_any_pose(walker: Landmarks):
    person = dataclasses.replace(
        changed(walker, 10, 15, torch.tensor([-900.0, 300.0])),
        mattes=torch.zeros(FRAMES, 800, 900, dtype=torch.uint8),
    )
    track = clean(person, PACE, 600.0, any_pose=True)
    assert track.flags.jumped[10, 15]
    assert (track.person.points[10, 15] - walker.points[10, 15]).norm() < 30
