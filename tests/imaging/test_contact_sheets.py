import numpy as np
import pytest

from deblur_avatar.imaging.contact_sheets import (
    BACKGROUND,
    GAP,
    LABEL_HEIGHT,
    contact_sheet,
)


def plain(code: int, height: int = 8, width: int = 12) -> np.ndarray:
    return np.full((height, width, 3), code, np.uint8)


def test_pictures_stand_in_rows_from_left_to_right():
    sheet = contact_sheet([plain(0), plain(50), plain(100)], 2)
    assert sheet.shape == (2 * (8 + GAP) + GAP, 2 * (12 + GAP) + GAP, 3)
    second_row, second_column = GAP + 8 + GAP, GAP + 12 + GAP
    assert (sheet[GAP : GAP + 8, GAP : GAP + 12] == 0).all()
    assert (sheet[GAP : GAP + 8, second_column : second_column + 12] == 50).all()
    assert (sheet[second_row : second_row + 8, GAP : GAP + 12] == 100).all()
    assert (sheet[second_row:, second_column:] == BACKGROUND).all()


def test_a_smaller_picture_is_centred_and_not_scaled():
    sheet = contact_sheet([plain(0), plain(50, 4, 6)], 2)
    left = GAP + 12 + GAP + 3
    assert (sheet[GAP + 2 : GAP + 6, left : left + 6] == 50).all()
    assert (sheet == 50).sum() == 4 * 6 * 3


def test_labels_stand_above_their_pictures_and_never_on_them():
    images = [plain(200, 30, 60), plain(200, 30, 60)]
    labels = ["ours", "a label far too long for its picture"]
    sheet = contact_sheet(images, 2, labels)
    bare = contact_sheet(images, 2)
    head = sheet[GAP : GAP + LABEL_HEIGHT]
    assert (head[:, GAP : GAP + 60] < BACKGROUND).any()
    assert (head[:, GAP + 60 : GAP + 60 + GAP] == BACKGROUND).all()
    assert (head[:, -GAP:] == BACKGROUND).all()
    assert np.array_equal(sheet[GAP + LABEL_HEIGHT :], bare[GAP:])


def test_fewer_pictures_than_columns_leave_no_empty_columns():
    assert contact_sheet([plain(0)], 5).shape[1] == 12 + 2 * GAP


@pytest.mark.parametrize(
    ("images", "columns", "labels", "complaint"),
    [
        ([], 2, None, "0 pictures in 2 columns"),
        ([plain(0)], 0, None, "1 pictures in 0 columns"),
        ([plain(0)], 1, ["a", "b"], "1 pictures have 2 labels"),
    ],
)
def test_what_makes_no_sheet_is_refused(images, columns, labels, complaint):
    with pytest.raises(ValueError, match=complaint):
        contact_sheet(images, columns, labels)
