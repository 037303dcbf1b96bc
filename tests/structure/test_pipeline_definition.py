"""dvc.yaml tells the truth, and the truth about sharp frames stays out of reach of fitting."""

import ast
import re
import subprocess
import sys
from functools import cache, reduce

import pytest

from deblur_avatar.pipeline.code import (
    FINGERPRINTS,
    REGISTERED,
    fingerprints,
    import_closure,
    scripts,
)
from tests.structure.pipeline_files import (
    PARAMS,
    PIPELINE,
    ROOT,
    experiments,
    gathering,
    options_of,
    params_of,
    paths_in,
    read,
    script_of,
    stages,
)

STAGES = stages()
PIPELINES = [ROOT / PIPELINE, *(folder / PIPELINE for folder in experiments()), *gathering()]
SCRIPTS = sorted((ROOT / "stages").glob("*.py"))
PARAMETERS = read(ROOT / PARAMS)
CODE = re.compile(r"\.(py|cpp|h|jinja)$|(^|/)(deblur_avatar|stages|benchmarks)(/|$)")
MAX_BYTES = 12_500  # of the root's dvc.yaml
# Of a lock for each of its stages: where one stage gathers all others' results, and on average.
MAX_LINES, MAX_MEAN_LINES = 280, 100
VAGUE = {"util", "utils", "helper", "helpers", "common", "misc", "base", "manager", "managers"}
every_stage = pytest.mark.parametrize("name", STAGES)
every_pipeline = pytest.mark.parametrize("path", PIPELINES, ids=lambda p: str(p.relative_to(ROOT)))


def main_of(script):
    tree = ast.parse(script.read_text())
    return next(n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "main")


def loaded_sections(stage):
    """The sections of params.yaml that a script loads, in dvc.yaml's own notation."""
    main = main_of(script_of(stage))
    known = options_of(stage)
    sections = set()
    nodes = list(ast.walk(main))
    if any(isinstance(node, ast.Name) and node.id == "fitting_stage" for node in nodes):
        nodes += ast.walk(ast.parse((ROOT / "deblur_avatar/training/fitting_stage.py").read_text()))
    for node in nodes:
        if isinstance(node, ast.Assign) and _key(node.value) is not None:
            (target,) = node.targets
            if isinstance(target, ast.Name) and isinstance(_key(node.value), ast.Constant):
                known[target.id] = "${" + _key(node.value).value + "}"
    for node in nodes:
        key = _key(node)
        if isinstance(key, ast.Constant):
            sections.add(key.value)
        elif isinstance(key, ast.JoinedStr):
            parts = [
                p.value if isinstance(p, ast.Constant) else known[p.value.id] for p in key.values
            ]
            sections.add("".join(parts))
        else:
            assert key is None, "keys of load_params must be literals or f-strings"
    return sections


def _key(node):
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("load_params"):
        return node.args[1]
    return None


@every_pipeline
def test_stages_depend_on_their_fingerprint_and_list_no_code(path):
    for name, stage in stages(path).items():
        assert not [dep for dep in paths_in(stage, "deps") if CODE.search(dep)], name
        if name != "code":
            own, *kinds = params_of(stage)[FINGERPRINTS]
            assert own == script_of(stage).stem == name
            assert name in {script.stem for script in scripts(ROOT)}
            assert {key.partition(".")[0] for key in kinds} == registries_of(script_of(stage))
            assert set(kinds) >= entries_declared(stage), name


@cache
def registries_of(script):
    """The sections whose kinds a script may run."""
    closure = import_closure(script, ROOT)
    return {name for name, kinds in REGISTERED.items() if ROOT / kinds.registry in closure}


def entries_declared(stage):
    """The recipes and methods that a stage reads: `avatars.lean`."""
    said = params_of(stage)
    keys = [key for file, declared in said.items() if file != FINGERPRINTS for key in declared]
    found = (re.match(r"(avatars|methods)\.(\$\{.*?\}|\w+)", key) for key in keys)
    return {entry[0] for entry in found if entry}


def test_the_pipeline_is_short_enough_to_read():
    assert len((ROOT / PIPELINE).read_bytes()) < MAX_BYTES


def test_the_locks_are_short():
    locks = [path.with_name("dvc.lock") for path in PIPELINES]
    texts = {str(lock): lock.read_text() for lock in locks if lock.is_file()}
    stages_of = {lock: len(re.findall(r"^  [\w@].*:$", text, re.M)) for lock, text in texts.items()}
    lines = {k: len(texts[k].splitlines()) / count for k, count in stages_of.items() if count}
    assert lines
    assert max(lines.values()) < MAX_LINES, lines
    written = sum(len(text.splitlines()) for text in texts.values())
    assert written / sum(stages_of.values()) < MAX_MEAN_LINES, lines


@every_stage
def test_a_stage_declares_exactly_the_parameters_it_loads(name):
    said = params_of(STAGES[name])
    declared = [key for file, keys in said.items() if file != FINGERPRINTS for key in keys]
    assert sorted(declared) == sorted(loaded_sections(STAGES[name]))


@every_stage
def test_a_command_gives_exactly_the_arguments_its_script_takes(name):
    taken = {argument.arg for argument in main_of(script_of(STAGES[name])).args.args}
    assert set(options_of(STAGES[name])) == taken


@every_stage
def test_every_path_of_a_command_is_declared(name):
    stage = STAGES[name]
    declared = paths_in(stage, "deps") + paths_in(stage, "outs") + [PARAMS]
    for option, value in options_of(stage).items():
        if "/" in value:
            covered = [
                p for p in declared if f"{p}/".startswith(f"{value}/") or value.startswith(p)
            ]
            assert covered, f"--{option} {value}"


def test_only_evaluation_and_the_learning_curve_depend_on_the_reference():
    readers = {n for n, s in STAGES.items() if any("reference" in d for d in paths_in(s, "deps"))}
    named = {n for n, s in STAGES.items() if "reference" in str(s["cmd"])}
    assert readers == named == {"evaluate", "learning_curve"}


def test_only_scores_and_pages_depend_on_sharp_frames_by_name():
    """Fits see them where a run says so, which the two tests of runs below hold."""
    for path in PIPELINES:
        readers = {
            name
            for name, stage in stages(path).items()
            if any(re.search("/(sharp|exact)$", dep) for dep in paths_in(stage, "deps"))
        }
        assert readers <= {"score_predeblur", "export"}, path


def test_nothing_that_is_fitted_or_scored_depends_on_an_export():
    for path in PIPELINES:
        for name, stage in stages(path).items():
            exported = [dep for dep in paths_in(stage, "deps") if dep.startswith("data/export")]
            assert not exported or name == "report", path


def test_fitting_depends_on_nothing_of_the_clip():
    for name in ("warmup", "trajectory", "fusion", "animate", "export"):
        deps = paths_in(STAGES[name], "deps")
        assert deps
        assert not [dep for dep in deps if re.search("/(clip|blur)/", dep)]


def test_only_reports_depend_on_what_a_clock_says():
    for path in PIPELINES:
        for name, stage in stages(path).items():
            written = {out for out in paths_in(stage, "outs") if out.startswith("metrics/cost/")}
            assert not written or name in ("warmup", "trajectory", "fusion", "evaluate")
            read = [d for d in paths_in(stage, "deps") if re.search(r"metrics(/cost.*)?$", d)]
            assert not read or name in ("report", "ablations", "proof", "proof_strips")


def test_only_the_ceiling_is_told_the_exact_poses():
    for name, run in PARAMETERS["runs"].items():
        assert (run["observations"] == "exact") == (run["method"] == "ceiling"), name


def test_only_the_oracle_and_the_ceiling_see_sharp_frames():
    for name, run in PARAMETERS["runs"].items():
        sharp = run["observations"] in ("sharp", "exact")
        assert sharp == (run["method"] in ("oracle", "ceiling")), name


def test_what_methods_are_said_to_be_fitted_to_is_what_their_runs_are_fitted_to():
    said = PARAMETERS["observations"]
    assert said.keys() < PARAMETERS["methods"].keys()
    for name, run in PARAMETERS["runs"].items():
        assert run["observations"] == said.get(run["method"], "blurred"), name
    found = [
        (run["method"], run["observations"])
        for folder in experiments()
        for run in read(folder / PARAMS)["runs"].values()
        if run["method"] in said
    ]
    assert set(found) == set(said.items())


def test_runs_and_warmups_are_named_after_what_they_are():
    for name, run in PARAMETERS["runs"].items():
        assert name == f"{run['scene']}-{run['method']}"
    for name, warmup in PARAMETERS["warmups"].items():
        assert name == f"{warmup['scene']}-{warmup['observations']}-{warmup['avatar']}"


def test_every_script_is_a_stage_and_has_its_module():
    own = {name: stage for path in gathering() for name, stage in stages(path).items()}
    assert {script_of(stage) for stage in [*STAGES.values(), *own.values()]} == set(scripts(ROOT))
    modules = {path.name for path in (ROOT / "deblur_avatar/pipeline").glob("*.py")}
    assert modules - {"__init__.py"} == {script.name for script in SCRIPTS}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_a_sentence(script):
    assert len(script.read_text().splitlines()) <= 40
    branching = (ast.If, ast.For, ast.While, ast.Try, ast.IfExp, ast.comprehension, ast.BinOp)
    steps = [node for node in ast.walk(main_of(script)) if isinstance(node, branching)]
    joined = (ast.Div, ast.BitOr)  # paths and dictionaries are put together so
    steps = [n for n in steps if not (isinstance(n, ast.BinOp) and isinstance(n.op, joined))]
    assert not steps, ast.unparse(steps[0])


def test_stages_do_not_import_each_other():
    for script in SCRIPTS:
        assert not re.search(r"(from|import) stages", script.read_text()), script


def test_no_path_says_that_it_holds_whatever_was_left_over():
    for folder in ("deblur_avatar", "stages", "tests", "benchmarks", "docs"):
        for path in (ROOT / folder).rglob("*"):
            words = set(re.split(r"[^a-z]+", str(path.relative_to(ROOT)).lower()))
            assert not words & VAGUE, path


def test_dvc_understands_the_pipeline():
    command = [sys.executable, "-m", "dvc", "stage", "list"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    listed = {line.split()[0].split("@")[0] for line in done.stdout.splitlines() if line.strip()}
    assert listed == set(STAGES)
    for run in PARAMETERS["runs"]:
        assert f"evaluate@{run}" in done.stdout


def value_at(content, key):
    """What stands at a key of DVC's notation; None where nothing does."""
    return reduce(lambda found, word: (found or {}).get(word), key.split("."), content)


def test_the_lock_is_of_the_parameters_and_the_code_that_stand():
    """`dvc repro` of a clone without data runs nothing but `code`: what was run is what is here."""
    standing = {PARAMS: PARAMETERS, FINGERPRINTS: fingerprints(ROOT, ROOT)}
    locked = read(ROOT / "dvc.lock")["stages"]
    assert len(locked) > 50
    stale = [
        f"{name}: {key} of {file}"
        for name, entry in locked.items()
        for file, values in entry.get("params", {}).items()
        for key, value in values.items()
        if value != value_at(standing[file], key)
    ]
    assert not stale
