"""The house style's rules that a machine can check: sizes, and words that have a better one."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAX_MODULE, MAX_FUNCTION = 400, 60  # lines
CODE = [
    path
    for folder in ("deblur_avatar", "stages", "benchmarks")
    for path in sorted((ROOT / folder).rglob("*.py"))
]
# But those of the small cases: their scenes are called as they were when relocking began.
PARAMETERS = [
    path
    for path in [ROOT / "params.yaml", *sorted((ROOT / "experiments").rglob("params.yaml"))]
    if "cases" not in path.parts
]
# Private words as names in code, and the field's word for each.
WORDS = {
    "blind": "agnostic",
    "isotropy": "isometry",
    "dressed": "frame_state",
    "endure": "run_mode",
    "see_with_one_eye": "apply_monocular_prior",
    "look_up_again": "invalidate_neighbours",
    "unevenness": "knn_smoothness",
    "even_colors": "smooth_colors",
    "even_shapes": "smooth_shapes",
    "even_heights": "smooth_heights",
    "Descent": "Optimizers",
    "StartParams": "RecipeParams",
    "explained_frames": "held_out_blur",
    "own_motion": "captured_motion",
    "own_video": "from_video",
    "feet_of": "closest_points",
    "lend": "fill_untrained_latents",
    "so-manieth": "n-th",
}
REMEMBERS = "SEED_NAMES"  # the one table that may: what seeds are derived from
PATH_WORDS = {"utils", "util", "helpers", "helper", "common", "misc", "base", "manager"}


def _id(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", CODE, ids=_id)
def test_a_module_is_one_idea_in_at_most_400_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MAX_MODULE


def test_functions_have_at_most_60_lines() -> None:
    long = [
        f"{_id(path)}:{node.lineno} {node.name} {node.end_lineno - node.lineno + 1}"
        for path in CODE
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or 0) - node.lineno + 1 > MAX_FUNCTION
    ]
    assert not long


def layers_in(document: str) -> list[set[str]]:
    """Layers of the package as a document's block of them has it: `above > below | beside`."""
    (block,) = re.findall(r"^```\n(cli > .*?)^```", document, re.MULTILINE | re.DOTALL)
    return [{name.strip() for name in layer.split("|")} for layer in block.split(">")]


def test_the_layers_that_are_told_are_those_that_the_linter_keeps() -> None:
    content = tomllib.loads((ROOT / "pyproject.toml").read_text())
    (layers,) = (
        contract["layers"]
        for contract in content["tool"]["importlinter"]["contracts"]
        if contract["type"] == "layers"
    )
    kept = [set(layer.split(" | ")) for layer in layers]
    assert layers_in((ROOT / "CONTRIBUTING.md").read_text()) == kept


def test_private_words_are_gone_from_code_and_parameters() -> None:
    words = re.compile("|".join(rf"(?<![\w]){re.escape(word)}(?![\w])" for word in WORDS))
    places = [
        f"{_id(path)}: {match[0]} is {WORDS[match[0]]}"
        for path in [
            *CODE,
            *PARAMETERS,
        ]
        for line in path.read_text().splitlines()
        if not line.startswith(f"{REMEMBERS} =")
        for match in words.finditer(line)
    ]
    assert not places


def test_no_path_is_named_after_a_purpose() -> None:
    assert not [path for path in CODE if PATH_WORDS & set(path.with_suffix("").parts)]


def test_what_is_drawn_is_drawn_on_the_cpu() -> None:
    """On the device it would be other numbers, and none at all where the generator is the CPU's."""
    calls = [
        (path, node, {keyword.arg for keyword in node.keywords})
        for path in CODE
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
    ]
    drawn = [
        f"{_id(path)}:{node.lineno}"
        for path, node, given in calls
        if {"generator", "device"} <= given
        and isinstance(node.func, ast.Attribute)
        and ast.unparse(node.func).startswith("torch.")
    ]
    generators = [
        f"{_id(path)}:{node.lineno}"
        for path, node, _ in calls
        if ast.unparse(node.func) == "torch.Generator" and (node.args or node.keywords)
    ]
    assert not drawn
    assert generators == [where for where in generators if where.startswith("deblur_avatar/run.py")]
