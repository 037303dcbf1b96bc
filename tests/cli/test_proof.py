import logging
from dataclasses import dataclass

import pytest
from ruamel.yaml import YAML

from deblur_avatar.cli import proof, running_dvc
from deblur_avatar.cli.main import main
from deblur_avatar.config.proof import Cell, cells_of
from tests.cli.test_repro import Commands
from tests.proof_results import COSTS, PLAN, small_plan, write_cell
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
        "scenes": dict.fromkeys(("leaping", "leaping_17"), scene), "proof": PLAN, "costs": COSTS,
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
    assert "0.3 hours of one core (an abacus); with 2 stages at a time" in caplog.text


def test_what_is_there_costs_nothing_more(folder, caplog):
    for cell in cells_of(small_plan(), ["grid"]).values():
        write_cell(folder / "experiments/proof/metrics", cell, 18.0)
    with caplog.at_level(logging.INFO):
        assert main(["proof", "--plan"]) == 0
    assert "15 cells, 12 of them there already." in caplog.text
    assert "leaping_17: 0 cells (), 0 min" in caplog.text


@pytest.fixture
def swept(monkeypatch):
    """What sweeps were asked for: targets, and how many at a time; each ends well."""
    asked = []

    def sweep(root, targets, cores, *, engine):
        asked.append((targets, cores))
        return asked_codes.pop(0) if asked_codes else 0

    asked_codes = []
    monkeypatch.setattr(proof, "sweep", sweep)
    return Swept(asked, asked_codes)


@dataclass
class Swept:
    calls: list
    codes: list


PAGE = ["-m", "dvc", "--wait-for-lock", "repro", "--single-item", "experiments/proof/dvc.yaml"]


def test_all_cells_are_swept_and_then_the_page_is_written(folder, swept, monkeypatch):
    commands = Commands(monkeypatch, [0])
    assert main(["proof", "--at-once", "3"]) == 0
    ((targets, cores),) = swept.calls
    assert cores == 3
    assert len(targets) == len(set(targets)) == 2 * 15
    assert "experiments/proof/leaping/dvc.yaml:evaluate@plain-clip-x1-seed_1" in targets
    assert "experiments/proof/leaping_17/dvc.yaml:learning_curve@plain-clip-x1-seed_0" in targets
    assert commands.calls == [PAGE]


def test_a_part_is_swept_alone(folder, swept, monkeypatch):
    Commands(monkeypatch, [0])
    assert main(["proof", "--parts", "converged"]) == 0
    ((targets, _),) = swept.calls
    assert {target.partition(":")[0] for target in targets} == {"experiments/proof/studio/dvc.yaml"}


def test_a_cell_that_fails_leaves_the_page_as_it_was(folder, swept, monkeypatch):
    commands = Commands(monkeypatch, [])
    swept.codes.append(1)
    assert main(["proof"]) == 1
    assert commands.calls == []


def without_motions(folder, motions):
    """Let scenes of the small proof move as files do that are not there."""
    path = folder / "experiments/proof/params.yaml"
    content = YAML(typ="safe").load(path)
    for scene, motion in motions.items():
        clip = content["scenes"][scene]["clip"] | {"motion": motion}
        content["scenes"][scene] = content["scenes"][scene] | {"clip": clip}
    with path.open("w") as file:
        YAML().dump(content, file)


def test_a_scene_whose_motion_is_missing_is_named_and_left_out(folder, caplog):
    without_motions(folder, {"leaping": "nowhere.bvh"})
    with caplog.at_level(logging.INFO):
        assert main(["proof", "--plan"]) == 0
    reason = "no motion file nowhere.bvh (scenes.leaping.clip.motion)"
    assert f"scene leaping is left out: {reason}\n" in caplog.text, "no variable would help"
    assert "6 cells, 0 of them there already." in caplog.text
    assert "in none of these figures: 9 of 15 cells, those of leaping.\n" in caplog.text


def test_a_scene_that_a_variable_would_give_its_motion_names_it(folder, monkeypatch, caplog):
    monkeypatch.setenv("DANCE_BVH", "elsewhere.bvh")
    without_motions(folder, {"leaping": "$(DANCE_BVH:-../mocap/dance.bvh)"})
    for cell in cells_of(small_plan(), ["grid", "seeds"]).values():
        write_cell(folder / "experiments/proof/metrics", cell, 18.0)
    with caplog.at_level(logging.INFO):
        assert main(["proof", "--plan"]) == 0
    reason = "no motion file elsewhere.bvh (scenes.leaping.clip.motion); set DANCE_BVH"
    assert f"scene leaping is left out: {reason}, which docs/evidence.md explains" in caplog.text
    left_out = "9 of 15 cells, those of leaping; set DANCE_BVH, which docs/evidence.md explains."
    assert f"Left out, and in none of these figures: {left_out}" in caplog.messages[-1]


def test_where_no_scene_can_be_made_the_variables_that_would_help_are_named(
    folder, monkeypatch, capsys
):
    for name in ("CMU_BVH", "DANCE_BVH"):
        monkeypatch.delenv(name, raising=False)
    motions = {"leaping": "$(CMU_BVH:-nowhere.bvh)", "leaping_17": "${DANCE_BVH}"}
    without_motions(folder, motions)
    assert main(["proof", "--parts", "grid"]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "ConfigError: no scene of grid can be made here; set CMU_BVH, DANCE_BVH, which "
        "docs/evidence.md explains"
    )


def test_a_part_that_is_not_there_is_one_line(folder, capsys):
    assert main(["proof", "--parts", "grit"]) == 1
    error = capsys.readouterr().err
    assert error == ("ConfigError: no part 'grit' in the proof, there is grid, seeds, converged\n")


def test_a_cell_is_there_once_its_last_stage_has_written(folder):
    cell = Cell("leaping", "plain", "clip", "x1", 0)
    write_cell(folder / "experiments/proof/metrics", cell, 18.0, curve=False)
    assert not proof.is_there(cell)
    write_cell(folder / "experiments/proof/metrics", cell, 18.0)
    assert proof.is_there(cell)
