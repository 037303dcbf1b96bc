"""Two versions are the same if every byte is; a mutant of any kind is found and named."""

import json
import shutil

import pytest
import torch
from safetensors.torch import save_file

from deblur_avatar.errors import ConfigError
from tests.equivalence.cases import Job
from tests.equivalence.comparison import Side, compare
from tests.equivalence.names import Renaming

NOTHING = Renaming({})
METRICS = {"psnr": 21.5, "seconds": 3.0, "run": {"seed": 0}, "kept": [1, 2]}
AVATAR = "cases/data/fusion/one/avatar"


def job(name, *outs):
    return Job(f"cases:{name}", ".", [], [], list(outs), [])


def side(tree, item="one"):
    outs = f"cases/data/fusion/{item}", f"cases/metrics/fusion/{item}.json"
    return Side(tree, [job(f"fusion@{item}", *outs)])


@pytest.fixture
def then(tmp_path):
    tree = tmp_path / "then"
    (tree / AVATAR).mkdir(parents=True)
    save_file(
        {"means": torch.zeros(3), "scales": torch.ones(2)}, tree / AVATAR / "tensors.safetensors"
    )
    (tree / AVATAR / "manifest.json").write_text('{"schema": "avatar/1", "kind": "blind"}')
    (tree / AVATAR / "0.png").write_bytes(b"\x89PNG picture")
    (tree / "cases/metrics/fusion").mkdir(parents=True)
    (tree / "cases/metrics/fusion/one.json").write_text(json.dumps(METRICS))
    return tree


@pytest.fixture
def now(then, tmp_path):
    return shutil.copytree(then, tmp_path / "now")


def lines(then, now, renaming=NOTHING):
    return [line for _, line in compare(then, now, renaming).differences]


def test_the_same_files_are_the_same(then, now):
    found = compare(side(then), side(now), NOTHING)
    assert (found.differences, found.one_sided, found.renamed) == ([], [], set())
    assert found.compared == {"cases:fusion@one"}


def test_one_changed_byte_of_a_picture_is_named(then, now):
    (now / AVATAR / "0.png").write_bytes(b"\x89PNG pictura")
    assert lines(side(then), side(now)) == [f"fusion: {AVATAR}/0.png differs"]


def test_one_changed_number_of_a_tensor_is_named(then, now):
    save_file(
        {"means": torch.zeros(3), "scales": torch.tensor([1.0, 1.5])},
        now / AVATAR / "tensors.safetensors",
    )
    (line,) = lines(side(then), side(now))
    assert line == f"fusion: {AVATAR}/tensors.safetensors differs in scales, by 0.5 at most"


def test_tensors_of_another_precision_are_named(then, now):
    save_file(
        {"means": torch.zeros(3), "scales": torch.ones(2, dtype=torch.float64)},
        now / AVATAR / "tensors.safetensors",
    )
    (line,) = lines(side(then), side(now))
    assert "precision" in line


def test_a_changed_value_of_metrics_is_named(then, now):
    path = "cases/metrics/fusion/one.json"
    (now / path).write_text(json.dumps(METRICS | {"psnr": 21.6}))
    assert lines(side(then), side(now)) == [f"fusion: {path}: psnr was 21.5, is 21.6"]


@pytest.mark.parametrize("missing", ["then", "now"])
def test_a_missing_file_is_named(then, now, missing):
    ({"then": then, "now": now}[missing] / AVATAR / "0.png").unlink()
    when = "only now" if missing == "then" else "only before"
    assert lines(side(then), side(now)) == [f"fusion: {AVATAR}/0.png is there {when}"]


def test_clocks_decide_nothing_and_split_metrics_are_listed(then, now):
    split = {"psnr": 21.5, "seconds": 4.0, "run": {"seed": 0}, "precision": "float32"}
    (now / "cases/metrics/fusion/one.json").write_text(json.dumps(split))
    found = compare(side(then), side(now), NOTHING)
    assert found.differences == []
    assert found.one_sided == ["fusion: kept: only before", "fusion: precision: only now"]


def test_a_stage_that_was_split_off_is_compared_by_its_files(then, now):
    whole, metrics = side(then), "cases/metrics/fusion/one.json"
    split = Side(now, [job("fusion@one", "cases/data/fusion/one"), job("score@one", metrics)])
    assert compare(whole, split, NOTHING).compared == {"cases:fusion@one", "cases:score@one"}
    (now / "cases/metrics/more.json").write_text("{}")
    new = Side(now, [*split.jobs, job("more@one", metrics, "cases/metrics/more.json")])
    assert "cases:more@one" not in compare(whole, new, NOTHING).compared


def test_a_clock_in_an_artifact_decides_nothing(then, now):
    for tree, seconds in ((then, 1.0), (now, 2.0)):
        (tree / AVATAR / "measured.json").write_text(json.dumps({"psnr": 3, "seconds": seconds}))
    found = compare(side(then), side(now), NOTHING)
    assert (found.differences, found.renamed) == ([], set())


def test_renamed_folders_and_words_are_the_same_only_by_their_renaming(then, now):
    (now / "cases/data/fusion/one").rename(now / "cases/data/fusion/uno")
    metrics = now / "cases/metrics/fusion"
    (metrics / "one.json").rename(metrics / "uno.json")
    (now / "cases/data/fusion/uno/avatar/manifest.json").write_text('{"kind": "agnostic"}')
    (then / AVATAR / "manifest.json").write_text('{"kind": "blind"}')
    sides = side(then), side(now, "uno")
    assert compare(*sides, NOTHING).compared == set()
    found = compare(*sides, Renaming.parsed("one=uno,blind=agnostic"))
    assert (found.differences, found.compared) == ([], {"cases:fusion@uno"})


def test_a_stage_is_said_to_hold_other_words_within_its_artifacts(then, now):
    (now / AVATAR / "manifest.json").write_text('{"schema": "avatar/1", "kind": "agnostic"}')
    assert len(lines(side(then), side(now))) == 1
    found = compare(side(then), side(now), Renaming.parsed("blind=agnostic"))
    assert (found.differences, found.renamed) == ([], {"fusion"})


def test_whole_words_are_renamed():
    renaming = Renaming.parsed("motion=move, blind=agnostic,stability/blind=stress/agnostic")
    assert (
        renaming.text("data/studio-blind/no_motion.motion") == "data/studio-agnostic/no_motion.move"
    )
    assert renaming.text("stability/blind:a@blind") == "stress/agnostic:a@agnostic"
    with pytest.raises(ConfigError, match="old=new"):
        Renaming.parsed("blind")
