"""What one machine made is there on another, by a remote of DVC's cache that both reach."""

from tests.sweep.small_sweep import ROOT, called, copied


def test_a_clone_pulls_what_was_made_elsewhere_and_is_up_to_date(serial, tmp_path):
    first, second, remote = (tmp_path / name for name in ("first", "second", "remote"))
    copied(serial, first)
    called(first, "dvc", "remote", "add", "--default", "shared", str(remote))
    called(first, "dvc", "push", "dvc.yaml")
    called(first, "git", "add", "-A", "--force", "metrics", "code.json", "dvc.lock", ".dvc/config")
    called(first, "git", "commit", "-qm", "results")
    called(tmp_path, "git", "clone", "-q", str(first), str(second))
    assert not (second / "data").exists()
    called(second, "dvc", "pull", "dvc.yaml")
    assert (second / "data/score/root_one/text").read_text() == (
        first / "data/score/root_one/text"
    ).read_text()
    called(second, "python", f"{ROOT}/stages/code.py", "--root", ".", "--out", "code.json")
    said = called(second, "dvc", "repro", "--dry", "-s", "fit@root_one", "score@root_one")
    assert "Running" not in said
    assert "up to date" in said
