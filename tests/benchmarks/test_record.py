"""What a benchmark prints is what it keeps."""

import json

import pytest

from benchmarks.record import print_record


@pytest.mark.parametrize("indent", [1, 2])
def test_the_file_holds_what_was_printed_and_none_is_written_unasked(tmp_path, capsys, indent):
    record = {"rows": [{"ms": 1.5, "device": None}]}
    print_record(record, tmp_path / "deep" / "record.json", indent)
    said = capsys.readouterr().out
    assert said == json.dumps(record, indent=indent) + "\n"
    assert (tmp_path / "deep" / "record.json").read_text() == said
    print_record(record, None, indent)
    assert capsys.readouterr().out == said
    assert len(list(tmp_path.rglob("*.json"))) == 1
