import hashlib

import pytest

from deblur_avatar.readers import file_contents
from deblur_avatar.readers.file_contents import add_contents, contents_digest


def folder(path, **files):
    path.mkdir()
    for name, text in files.items():
        (path / f"{name}.py").write_text(text)
    return path


def test_folders_with_the_same_files_have_the_same_digest(tmp_path):
    one = folder(tmp_path / "one", first="1", second="2")
    assert contents_digest(one) == contents_digest(folder(tmp_path / "two", second="2", first="1"))


@pytest.mark.parametrize(
    "files", [{"first": "1"}, {"first": "1", "second": "3"}, {"first": "1", "third": "2"}]
)
def test_a_file_less_or_other_bytes_or_another_name_is_another_digest(tmp_path, files):
    one = folder(tmp_path / "one", first="1", second="2")
    assert contents_digest(one) != contents_digest(folder(tmp_path / "two", **files))


def test_what_moves_from_one_file_to_the_next_is_seen(tmp_path):
    one = folder(tmp_path / "one", first="12", second="3")
    assert contents_digest(one) != contents_digest(folder(tmp_path / "two", first="1", second="23"))


def test_a_file_larger_than_a_chunk_is_read_to_its_end(tmp_path, monkeypatch):
    monkeypatch.setattr(file_contents, "CHUNK", 4)
    path = tmp_path / "film"
    path.write_bytes(b"0123456789")
    assert contents_digest(path) == hashlib.sha256(b". 10\n0123456789").hexdigest()


def test_files_of_other_suffixes_do_not_count(tmp_path):
    one = folder(tmp_path / "one", first="1")
    digests = [hashlib.sha256(), hashlib.sha256()]
    add_contents(digests[0], one, (".py",))
    (one / "notes.txt").write_text("new")
    add_contents(digests[1], one, (".py",))
    assert digests[0].hexdigest() == digests[1].hexdigest()


def test_what_cannot_be_read_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        contents_digest(tmp_path / "nothing")
