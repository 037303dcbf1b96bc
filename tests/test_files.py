import json

import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.files import read_json, write_json


def test_json_is_rounded_to_six_digits_and_what_is_not_a_number_is_null(tmp_path):
    content = {"psnr": 31.23456789, 2: [1e-9 / 3, float("nan"), float("inf")], "n": (1, None, "a")}
    write_json(tmp_path / "deep" / "metrics.json", content)
    read = json.loads((tmp_path / "deep" / "metrics.json").read_text())
    assert read == {"psnr": 31.2346, "2": [3.33333e-10, None, None], "n": [1, None, "a"]}
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["metrics.json"]


def test_json_that_cannot_be_written_leaves_the_old_file(tmp_path):
    path = tmp_path / "metrics.json"
    write_json(path, {"psnr": 1.0})
    with pytest.raises(TypeError):
        write_json(path, {"psnr": object()})
    assert json.loads(path.read_text()) == {"psnr": 1.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "recursion"),
        ('{"seconds": NaN}', "not JSON compliant"),
        ('{"seconds": 1e999}', "not JSON compliant"),
        ('{"seconds": 1' + "0" * 400 + "}", "no number that a stage writes"),
        ('{"frame": -9223372036854775808}', "no number that a stage writes"),
    ],
)
def test_numbers_of_another_stage_that_are_none_are_refused(tmp_path, text, message):
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(ArtifactError, match=f"cannot read .*fit.json: .*{message}"):
        read_json(tmp_path / "fit.json")
