import logging
import threading

import pytest
from ruamel.yaml import YAML

from deblur_avatar.cli import proof, running_dvc
from deblur_avatar.cli.main import main
from deblur_avatar.config.proof import Cell, cells_of
from tests.cli.test_repro import Commands
from tests.proof_results import PLAN, small_plan, write_cell
from tests.sources.studio.test_unfitted_studio import OFF


@pytest.fixture
def folder(tiny_content, tmp_path, monkeypatch):
    """A checkout with a small proof: two scenes filmed there, one of the root's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(running_dvc, "refresh", lambda root: [])
    (tmp_path / "dvc.yaml").touch()
    (tmp_path / "stages").mkdir()
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(tiny_content, file)
    scene = tiny_content["scenes"]["studio"] | {"clip": OFF.model_dump() | {"betas": [0.5]}}
    content = {
        "shared": "../../params.yaml", "schedule": "x1", "snapshots": 3,
        "schedules": {
            name: {"warmup": 20 * k, "trajectory": 50 * k, "fusion": 100 * k}
            for name, k in (("x1", 1), ("x2", 2))
        },
        "scenes": dict.fromkeys(("leaping", "leaping_17"), scene), "proof": PLAN,
    }  # fmt: skip
    path = tmp_path / "experiments/proof/params.yaml"
    path.parent.mkdir(parents=True)
    with path.open("w") as file:
        YAML().dump(content, file)
    return tmp_path


def test_it_says_what_it_takes_before_it_starts(folder, caplog):
    with caplog.at_level(logging.INFO):
        assert main(["proof", "--plan"]) == 0
    assert "15 cells, 0 of them there already." in caplog.text
    assert "leaping: 9 cells (x1), 11 min" in caplog.text
    assert "leaping_17: 6 cells (x1), 9 min" in caplog.text
    assert "0.3 hours of one core (an abacus); with 2 scenes at a time" in caplog.text


def test_what_is_there_costs_nothing_more(folder, caplog):
    for cell in cells_of(small_plan(), ["grid"]).values():
        write_cell(folder / "experiments/proof/metrics", cell, 18.0)
    with caplog.at_level(logging.INFO):
        assert main(["proof", "--plan"]) == 0
    assert "15 cells, 12 of them there already." in caplog.text
    assert "leaping_17: 0 cells (), 0 min" in caplog.text


def test_scenes_are_worked_off_and_the_page_is_written(folder, monkeypatch):
    commands = Commands(monkeypatch, [0, 0, 0, 0])
    assert main(["proof", "--at-once", "1"]) == 0
    first, longest, other, page = commands.calls
    assert first == ["-m", "dvc", "repro", "body@anny"]
    alone = ["-m", "dvc", "--wait-for-lock", "repro", "--single-item"]
    assert longest[:5] == other[:5] == page[:5] == alone
    assert longest[5] == "experiments/proof/leaping/dvc.yaml:clip@leaping"
    assert other[5] == "experiments/proof/leaping_17/dvc.yaml:clip@leaping_17"
    assert page[5:] == ["experiments/proof/dvc.yaml"]


def test_every_target_comes_after_what_it_stands_on(folder):
    cells = [cell for cell in cells_of(small_plan()).values() if cell.scene == "leaping"]
    asked = [t.rpartition(":")[2] for t in proof.targets(small_plan(), "leaping", cells)]
    assert asked[:3] == ["clip@leaping", "blur@leaping", "preprocess@leaping"]
    assert len(asked) == len(set(asked)) == 3 + 6 + 4 * 9
    place = {target: index for index, target in enumerate(asked)}
    for chain in (
        ["preprocess@leaping", "warmup@plain-blurred-x1-seed_1"],
        ["warmup@plain-blurred-x1-seed_1", "trajectory@plain-clip-x1-seed_1"],
        [f"{stage}@plain-clip-x1-seed_1" for stage in proof.STAGES],
    ):
        assert [place[target] for target in chain] == sorted(place[target] for target in chain)


def test_a_scene_of_the_root_is_made_there(folder, monkeypatch):
    commands = Commands(monkeypatch, [0, 0, 0])
    assert main(["proof", "--parts", "converged"]) == 0
    assert commands.calls[0][3:] == ["body@anny", "preprocess@studio"]
    assert (
        commands.calls[1][5] == "experiments/proof/studio/dvc.yaml:warmup@plain-blurred-x1-seed_0"
    )


def test_a_scene_that_fails_leaves_the_others_to_go_on_and_no_page(folder, monkeypatch):
    commands = Commands(monkeypatch, [0, 3, 0])
    assert main(["proof", "--at-once", "1"]) == 3
    assert len(commands.calls) == 3


def test_nothing_is_fitted_where_the_footage_cannot_be_made(folder, monkeypatch):
    commands = Commands(monkeypatch, [3])
    assert main(["proof"]) == 3
    assert len(commands.calls) == 1


def test_a_scene_whose_motion_is_missing_is_named_and_left_out(folder, monkeypatch, caplog):
    path = folder / "experiments/proof/params.yaml"
    content = YAML(typ="safe").load(path)
    clip = content["scenes"]["leaping"]["clip"]
    content["scenes"]["leaping"] = content["scenes"]["leaping"] | {
        "clip": clip | {"motion": "nowhere.bvh"}
    }
    with path.open("w") as file:
        YAML().dump(content, file)
    with caplog.at_level(logging.INFO):
        assert main(["proof", "--plan"]) == 0
    assert "scene leaping is left out: no motion file nowhere.bvh" in caplog.text
    assert "6 cells, 0 of them there already." in caplog.text


def test_a_part_that_is_not_there_is_one_line(folder, capsys):
    assert main(["proof", "--parts", "grit"]) == 1
    error = capsys.readouterr().err
    assert error == ("ConfigError: no part 'grit' in the proof, there is grid, seeds, converged\n")


def test_two_scenes_run_at_a_time(folder, monkeypatch):
    """Each of two waits until the other has begun; alone either would wait for ever."""
    both = threading.Barrier(2, timeout=20)

    def finish(command, environment, folder):
        if any("clip@" in word for word in command):
            both.wait()
        return 0

    monkeypatch.setattr(running_dvc, "finish", finish)
    assert main(["proof"]) == 0


def test_a_cell_is_there_once_its_last_stage_has_written(folder):
    cell = Cell("leaping", "plain", "clip", "x1", 0)
    write_cell(folder / "experiments/proof/metrics", cell, 18.0, curve=False)
    assert not proof.is_there(cell)
    write_cell(folder / "experiments/proof/metrics", cell, 18.0)
    assert proof.is_there(cell)
