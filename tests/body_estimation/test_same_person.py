import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.body_estimation.landmarks import COUNT, Sighting
from deblur_avatar.body_estimation.same_person import (
    HIPS,
    KNEES,
    SHOULDERS,
    Look,
    is_same,
)

HEIGHT, WIDTH = 240, 320
SHIRT, TROUSERS = (200, 40, 40), (30, 60, 160)


def stand(right=160.0, down=120.0, size=120.0):
    """Landmarks of who stands: the head's and the hands' among them, all within her box."""
    points = torch.tensor([[right, down]]).repeat(COUNT, 1)
    points[:11, 1] -= size / 2
    points[SHOULDERS] += torch.tensor([[-0.15, -0.3], [0.15, -0.3]]) * size
    points[HIPS] += torch.tensor([[-0.1, 0.0], [0.1, 0.0]]) * size
    points[KNEES] += torch.tensor([[-0.1, 0.25], [0.1, 0.25]]) * size
    points[27:, 1] += size / 2
    return points


def dressed(points, shirt=SHIRT, trousers=TROUSERS):
    """A grey picture of somebody in a shirt and trousers."""
    frame = torch.full((HEIGHT, WIDTH, 3), 128, dtype=torch.uint8)
    left, right = points[:, 0].min() - 16, points[:, 0].max() + 16
    columns = slice(max(int(left), 0), max(int(right), 0))
    waist = int(points[HIPS, 1].mean())
    frame[int(points[SHOULDERS, 1].min()) - 12 : waist, columns] = torch.tensor(shirt).byte()
    frame[waist : int(points[:, 1].max()), columns] = torch.tensor(trousers).byte()
    return frame


def look(points=None, visibility=0.9, **clothes):
    points = stand() if points is None else points
    sighting = Sighting(
        points, torch.full((COUNT,), visibility), torch.zeros(COUNT, 3),
        torch.zeros(HEIGHT, WIDTH, dtype=torch.uint8),
    )  # fmt: skip
    return Look.of(sighting, dressed(points, **clothes))


OTHERS = {"shirt": (40, 160, 60), "trousers": (220, 220, 220)}


def test_a_look_is_place_size_and_colours_of_clothes():
    seen = look()
    torch.testing.assert_close(seen.centre, torch.tensor([160.0, 120.0]))
    assert seen.size == 120
    codes = np.float32([[SHIRT, SHIRT, TROUSERS, TROUSERS]]) / 255
    lab = torch.from_numpy(cv2.cvtColor(codes, cv2.COLOR_RGB2LAB)[0])
    torch.testing.assert_close(seen.colors, lab, atol=1e-3, rtol=0)
    assert seen.sureness == pytest.approx(0.9)


def test_a_hidden_landmark_does_not_make_her_larger():
    points = stand()
    points[15] = torch.tensor([5.0, 230.0])
    sighting = look(points).sighting
    sighting.visibility[15] = 0.1
    assert Look.of(sighting, dressed(stand())).size == 120


def test_who_moves_fast_in_her_clothes_is_the_same():
    assert is_same(look(stand(right=220.0)), [look()], 0)
    assert look().jumps_to(look(stand(right=220.0)), 1)
    assert not look().jumps_to(look(stand(right=220.0)), 100)  # frames later


def test_who_does_not_jump_may_change_colours():
    """She turns round, or a light goes on."""
    near = look(stand(right=164.0), **OTHERS)
    assert near.is_unlike([look()])
    assert is_same(near, [look()], 0)


def test_who_jumps_and_changes_colours_is_somebody_else():
    assert not is_same(look(stand(right=200.0), **OTHERS), [look()], 0)


def test_half_of_the_clothes_may_be_hidden():
    trousers_gone = look(stand(right=200.0), trousers=(240, 240, 240))
    assert is_same(trousers_gone, [look()], 0)
    assert not is_same(trousers_gone, [look(shirt=(250, 250, 0))], 0)


@pytest.mark.parametrize("missed", [0, 1, 5])
def test_after_a_gap_it_takes_both_too(missed):
    """Where she was she may be in another light; beside that, in other clothes, she is not."""
    assert is_same(look(stand(right=164.0), **OTHERS), [look()], missed)
    assert not is_same(look(stand(right=200.0), **OTHERS), [look()], missed)
    assert is_same(look(stand(right=200.0)), [look()], missed)


def test_colours_of_what_hides_her_are_not_hers():
    desk = look(stand(right=200.0), trousers=(240, 240, 240), shirt=(240, 240, 240))
    assert desk.is_unlike([look()])
    desk.sighting.visibility[HIPS] = 0.1
    behind = Look.of(desk.sighting, dressed(stand(right=200.0), (240, 240, 240), (240, 240, 240)))
    assert behind.colors.isnan().all()
    desk.sighting.visibility[HIPS] = 0.9
    desk.sighting.visibility[KNEES] = 0.1
    seated = Look.of(desk.sighting, dressed(stand(right=200.0), SHIRT, (240, 240, 240)))
    assert seated.colors.isnan().all(1).tolist() == [False, False, True, True]
    assert not seated.is_unlike([look()])


def test_colours_that_she_was_ever_seen_in_are_hers():
    back = look(stand(right=120.0), **OTHERS)
    assert is_same(look(stand(right=200.0), **OTHERS), [back, look()], 0)
    unsure = look(stand(right=120.0), visibility=0.4, **OTHERS)
    assert not is_same(look(stand(right=200.0), **OTHERS), [unsure, look()], 0)


@pytest.mark.parametrize(
    ("right", "size", "missed", "same"),
    [(230.0, 120.0, 0, True), (236.0, 120.0, 0, False), (236.0, 120.0, 1, True),
     (160.0, 46.0, 0, False), (160.0, 50.0, 0, True)],
)  # fmt: skip
def test_a_person_moves_and_grows_so_much_and_no_more(right, size, missed, same):
    assert is_same(look(stand(right=right, size=size)), [look()], missed) == same


def test_a_little_brighter_is_the_same_colour():
    assert not look(shirt=(215, 52, 50), trousers=(38, 68, 172)).is_unlike([look()])


def test_where_clothes_are_outside_the_picture_nothing_is_unlike():
    points = stand()
    points[:, 0] -= 172  # a thigh is left
    away = look(points, **OTHERS)
    assert away.colors.isnan().all(1).sum() == 3
    assert not away.is_unlike([look()])
    assert not look().is_unlike([away])
    assert not look().is_unlike([])


def test_where_few_landmarks_are_believed_all_tell_whether_she_jumps():
    here, beside = look(), look(stand(right=200.0))
    for hidden in (here, beside):
        hidden.sighting.visibility[: COUNT - 4] = 0.1
        hidden.sighting.points[COUNT - 4 :] = torch.tensor([140.0, 170.0])
    assert here.jumps_to(beside, 1)
    assert not here.jumps_to(here, 1)
    here.sighting.visibility[: COUNT - 5] = 0.9
    beside.sighting.visibility[COUNT - 5 :] = 0.9
    assert here.jumps_to(beside, 1)


def test_landmarks_that_are_not_believed_do_not_tell_of_a_jump():
    here, there = look(), look()
    there.sighting.points[:20] += 80.0
    assert here.jumps_to(there, 1)
    there.sighting.visibility[:20] = 0.1
    assert not here.jumps_to(there, 1)


def test_stripes_are_the_colour_that_they_have_from_afar():
    """Wherever its stripes lie a shirt is the same one."""
    colors = []
    for shift in (0, 2):
        frame = dressed(stand())
        stripes = (torch.arange(WIDTH) + shift) % 8 < 4
        frame[:, stripes] = 255
        colors.append(Look.of(look().sighting, frame).colors)
    assert (colors[0] - colors[1]).norm(dim=1).max() < 6
    assert (colors[0] - look().colors).norm(dim=1).min() > 10


@pytest.mark.parametrize(("moved", "jumps"), [(7, False), (10, True)])  # of 33
def test_a_jump_is_one_of_a_quarter_of_the_landmarks(moved, jumps):
    here, there = look(), look()
    there.sighting.points[:moved] += 80.0
    assert here.jumps_to(there, 1) == jumps


@pytest.mark.parametrize(("right", "jumps"), [(184.0, False), (190.0, True)])
def test_a_jump_is_by_the_size_of_the_larger_look(right, jumps):
    here, there = look(), look(stand(size=216.0))
    for one, at in ((here, 160.0), (there, right)):
        one.sighting.points[:] = torch.tensor([at, 120.0])
    assert (here.size, there.size) == (120, 216)
    assert here.jumps_to(there, 1) == there.jumps_to(here, 1) == jumps


def test_colours_at_an_edge_are_of_what_is_in_the_picture():
    for move in ((0.0, -90.0), (0.0, 150.0), (-172.0, 0.0), (172.0, 0.0)):
        points = stand() + torch.tensor(move)
        frame = torch.full((HEIGHT, WIDTH, 3), 128, dtype=torch.uint8)
        seen = Look.of(look().sighting._replace(points=points), frame).colors
        grey = look(shirt=(128,) * 3, trousers=(128,) * 3).colors[0]
        inside = ~seen.isnan().any(1)
        assert inside[0] or move[0]  # some of the chest is in the picture
        torch.testing.assert_close(seen[inside], grey.expand(int(inside.sum()), 3))


def test_of_who_is_small_colours_tell_nothing():
    small = look(stand(size=98.0), **OTHERS)
    assert small.colors.isnan().all()
    assert not look(stand(size=102.0), **OTHERS).colors.isnan().any()
