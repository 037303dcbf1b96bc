import dataclasses

import pytest

from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.errors import ArtifactError
from tests.deblurring_clips import striped_clips


def test_clips_are_read_as_they_were_saved(tmp_path):
    striped_clips().save(tmp_path / "clips")
    read = DeblurringClips.load(tmp_path / "clips")
    for field in ("sharp", "sharp_mattes", "blurred", "blurred_mattes"):
        assert getattr(read, field).equal(getattr(striped_clips(), field))
    assert read.windows == (3, 7)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"windows": (3,)}, "windows: 1 numbers for 2 windows"),
        ({"averaging_spaces": ("srgb",)}, "averaging_spaces: 1 for 2 persons"),
        ({"averaging_spaces": ("srgb", "gamma")}, "averaging_space must be srgb or linear"),
        ({"sharp": striped_clips(persons=1).sharp}, "must be"),
    ],
)
def test_clips_that_do_not_hang_together_are_refused(changes, complaint):
    with pytest.raises(ArtifactError, match=complaint):
        dataclasses.replace(striped_clips(), **changes)
