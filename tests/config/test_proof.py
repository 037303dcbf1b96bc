import pytest
from ruamel.yaml import YAML

from deblur_avatar.config.proof import (
    Cell,
    CostParams,
    cells_of,
    files_of,
    items_of_scene,
    load_plan,
    seconds_of,
    warmup_of,
)
from deblur_avatar.config.reading import load_params, parse, read_params
from deblur_avatar.errors import ConfigError
from tests.proof_results import COSTS, PLAN, small_plan

ITERATIONS = {"x1": (20, 100), "x2": (40, 200)}


def written(folder, **changes):
    """A parameter file with the small plan, and what it names."""
    content = {
        "seed": 0, "schedule": "x1", "snapshots": 3,
        "schedules": {name: {"warmup": w, "fusion": f} for name, (w, f) in ITERATIONS.items()},
        "scenes": {"leaping": {}, "leaping_17": {}},
        "avatars": {"paper": {}, "lean": {}},
        "methods": {name: {} for name in ("agnostic", "paper", "lean", "oracle")},
        "proof": PLAN | changes,
        "costs": COSTS,
    }  # fmt: skip
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(content, file)
    return folder / "params.yaml"


def test_a_cell_is_named_after_what_it_is():
    cell = Cell("leaping", "plain", "clip", "x2", 1)
    assert cell.name == "plain-clip-x2-seed_1"
    assert warmup_of(cell, small_plan()) == "plain-blurred-x2-seed_1"


def test_a_cell_that_two_parts_ask_for_is_there_once():
    cells = cells_of(small_plan())
    assert len(cells) == 12 + 3 + 4
    assert len(cells_of(small_plan(), ["grid", "seeds"])) == 15
    assert list(cells_of(small_plan(), ["converged"])) == [
        "studio/plain-agnostic-x1-seed_0", "studio/plain-clip-x1-seed_0",
        "studio/plain-agnostic-x2-seed_0", "studio/plain-clip-x2-seed_0",
    ]  # fmt: skip
    with pytest.raises(ConfigError, match="no part 'grit' in the proof, there is grid, seeds"):
        cells_of(small_plan(), ["grit"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parts": {"a": {"scenes": ["moon"], "schedules": [], "seeds": 1, "cells": {}}}},
         "proof.parts.a: no 'moon' among the scenes"),
        ({"parts": {"a": {"scenes": [], "schedules": ["x9"], "seeds": 1, "cells": {}}}},
         "proof.parts.a: no 'x9' among the schedules"),
        ({"parts": {"a": {"scenes": [], "schedules": [], "seeds": 1, "cells": {"clay": []}}}},
         "proof.parts.a: no 'clay' among the avatars"),
        ({"parts": {"a": {"scenes": [], "schedules": [], "seeds": 1,
                          "cells": {"plain": ["mad"]}}}, "run": ["a"]},
         "proof.parts.a: no 'mad' among the columns"),
        ({"columns": {"guess": PLAN["columns"]["paper"]}}, "no table has a column 'guess'"),
        ({"run": ["grit"]}, "no part 'grit' in the proof"),
        ({"avatars": {"plain": "clay", "networks": "paper"}}, "proof: avatars has no 'clay'"),
        ({"columns": {**PLAN["columns"], "paper": {"observations": "blurred", "method": "none"}}},
         "proof: methods has no 'none'"),
        ({"scenes": {**PLAN["scenes"], "lying": "report"}},
         "proof: scenes has no 'lying'"),
        ({"windows": {"leaping": {17: "moon"}}}, "proof.windows: there is no scene 'moon'"),
        ({"filmed_at_root": ["studio", "moon"]}, "proof.filmed_at_root: there is no scene 'moon'"),
        ({"without_pictures": ["moon"]}, "proof.without_pictures: there is no scene 'moon'"),
    ],
)  # fmt: skip
def test_a_name_that_stands_for_nothing_is_refused(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message):
        load_plan(written(tmp_path, **changes))


def test_a_plan_is_read_whole(tmp_path):
    assert load_plan(written(tmp_path)) == small_plan()


def test_costs_grow_with_iterations_and_share_scenes_and_warm_ups():
    plan, costs = small_plan(), parse(CostParams, COSTS, "costs")

    def cost(*cells):
        return seconds_of(plan, costs, cells, ITERATIONS)

    agnostic = Cell("leaping", "plain", "agnostic", "x1", 0)
    clip = Cell("leaping", "plain", "clip", "x1", 0)
    # Scene, fit, scores, starts; the second cell has scene and warm-up for nothing.
    assert cost(agnostic) == pytest.approx(100 + 30 + 10 + 5)
    assert cost(agnostic, clip) == pytest.approx(145 + 50 - 30 * 0.2 + 10 + 5)
    assert cost(Cell("leaping", "plain", "clip", "x2", 0)) == pytest.approx(100 + 100 + 10 + 5)
    elsewhere = Cell("studio", "plain", "agnostic", "x1", 0)
    assert cost(agnostic, elsewhere) == 2 * cost(agnostic)
    assert cost() == 0


def test_a_scene_runs_over_its_own_cells_and_their_warm_ups():
    items = items_of_scene(small_plan(), "leaping")
    assert items["filmed"] == ["leaping"]
    assert items["observed"] == "experiments/proof/data/leaping/preprocess"
    assert len(items["cells"]) == 9
    assert items["cells"]["plain-clip-x1-seed_1"] == {
        "avatar": "lean", "observations": "blurred", "method": "lean",
        "warmup": "plain-blurred-x1-seed_1", "schedule": "x1", "fit": "x1-seed_1",
    }  # fmt: skip
    assert {cell["warmup"] for cell in items["cells"].values()} == items["warmups"].keys()


def test_frames_are_deblurred_where_a_cell_sees_them_and_the_scene_is_filmed_here():
    assert items_of_scene(small_plan(), "leaping")["deblurred"] == []
    columns = PLAN["columns"] | {"deblurred": {"observations": "deblurred", "method": "agnostic"}}
    first = {"schedules": ["x1"], "seeds": 1, "cells": {"plain": ["deblurred"]}}
    parts = {"first": first | {"scenes": ["leaping", "studio"]}}
    plan = small_plan(columns=columns, parts=parts, run=["first"])
    items = items_of_scene(plan, "leaping")
    assert items["deblurred"] == ["leaping"]
    assert items["warmups"].keys() == {"plain-deblurred-x1-seed_0"}
    assert items_of_scene(plan, "studio")["deblurred"] == []
    assert items_of_scene(plan, "leaping_17")["deblurred"] == []


def test_a_scene_of_the_root_is_not_filmed_again():
    items = items_of_scene(small_plan(), "studio")
    assert items["filmed"] == []
    assert items["observed"] == "data/preprocess/studio"
    assert items["reference"] == "data/clip/studio/reference"


def test_a_plan_stands_for_files_that_yaml_and_scripts_read(tmp_path):
    written(tmp_path)
    (tmp_path / "scene.dvc.yaml").write_text("stages: {}\n")
    made = files_of(tmp_path)
    for path, content in made.items():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    names = {str(path.relative_to(tmp_path)) for path in made}
    assert {"leaping/dvc.yaml", "leaping/cells.yaml", "studio/cells.yaml"} <= names
    assert {"fits/x1-seed_0.yaml", "fits/x1-seed_1.yaml", "fits/x2-seed_0.yaml"} <= names
    assert (tmp_path / "studio/dvc.yaml").read_text() == "stages: {}\n"
    assert read_params(tmp_path / "leaping/cells.yaml") == items_of_scene(small_plan(), "leaping")
    fit = tmp_path / "fits/x2-seed_0.yaml"
    assert load_params(fit, "schedule", str) == "x2"
    assert load_params(fit, "snapshots", int) == 3
    assert load_params(fit, "schedules.x2.fusion", int) == 200
    assert load_params(tmp_path / "fits/x1-seed_1.yaml", "seed", int) == 1
