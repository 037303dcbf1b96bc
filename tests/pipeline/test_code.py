"""Fingerprints move with what code does, and with nothing else."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.code import (
    NO_SUCH_KIND,
    fingerprints,
    import_closure,
    refresh,
    scripts,
)
from tests.structure.pipeline_files import gathering, params_of, stages

ROOT = Path(__file__).parents[2]
SUITE = {"stability", "stability_scene", "stability_report", "self_check_cases"}
FITTING = {"warmup", "trajectory", "fusion", *SUITE}
FILES = {
    "stages/cut.py": "from pathlib import Path\nfrom deblur_avatar.pipeline.cut import cut\n",
    "stages/sew.py": "import deblur_avatar.pipeline.glue\n",
    "deblur_avatar/__init__.py": "",
    "deblur_avatar/pipeline/__init__.py": "",
    "deblur_avatar/pipeline/cut.py": (
        '"""Cuts."""\nimport numpy\nfrom typing import TYPE_CHECKING\n'
        "if TYPE_CHECKING:\n    from deblur_avatar.pipeline.glue import stick\n"
        'def cut(x, y):\n    """Cut it."""\n    from deblur_avatar.geometry import planes\n'
        '    from ..imaging.knives import sharpen\n    return f"{x:>{y}} {planes}", sharpen, 0.5\n'
    ),
    "deblur_avatar/pipeline/glue.py": 'LATER = "deblur_avatar.geometry.planes"\n',
    "deblur_avatar/geometry/__init__.py": "",
    "deblur_avatar/geometry/planes.py": "import math\n",
    "deblur_avatar/imaging/__init__.py": "",
    "deblur_avatar/imaging/knives.py": 'NAMES = "edge.cpp", "absent.cpp", "a.html"\n',
    "deblur_avatar/imaging/native/edge.cpp": (
        '#include "steel.h"\n#define TWICE(x) ((x) + (x)) // twice\nint edge() { return 1; }\n'
    ),
    "deblur_avatar/imaging/native/steel.h": "float hard = 1.f;\n",
    "deblur_avatar/imaging/a.html": "<p>\n",
    "deblur_avatar/imaging/spoons.cpp": "",
}


@pytest.fixture
def project(tmp_path):
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def moved(project, file, old, new, before=None):
    """Stages whose fingerprint moves when a text is replaced; it must be there once or more.

    From what it was `before`, which takes seconds to find out of the whole package.
    """
    before, path = before or fingerprints(project, project), project / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    after = fingerprints(project, project)
    path.write_text(text)
    return {name for name in before if before[name] != after[name]}


def test_imports_inside_functions_relative_ones_and_named_files_count(project):
    closure = import_closure(project / "stages/cut.py", project)
    assert {str(path.relative_to(project)) for path in closure} == {
        "stages/cut.py", "deblur_avatar/__init__.py", "deblur_avatar/pipeline/__init__.py",
        "deblur_avatar/pipeline/cut.py", "deblur_avatar/geometry/__init__.py",
        "deblur_avatar/geometry/planes.py", "deblur_avatar/imaging/__init__.py",
        "deblur_avatar/imaging/knives.py", "deblur_avatar/imaging/native/edge.cpp",
        "deblur_avatar/imaging/native/steel.h", "deblur_avatar/imaging/a.html",
    }  # fmt: skip


def test_headers_of_another_folder_count_wherever_the_root_is_named_from(project, monkeypatch):
    edge = project / "deblur_avatar/imaging/native/edge.cpp"
    edge.write_text('#include "../alloy.h"\n' + edge.read_text())
    (project / "deblur_avatar/imaging/alloy.h").write_text("float rust = 0.f;\n")
    monkeypatch.chdir(project)
    named = import_closure(Path("stages/cut.py"), Path())
    assert {project / path for path in named} == import_closure(project / "stages/cut.py", project)
    assert Path("deblur_avatar/imaging/alloy.h") in named
    assert fingerprints(project, project) == fingerprints(Path(), Path())


def test_a_module_named_in_a_string_counts(project):
    closure = import_closure(project / "stages/sew.py", project)
    assert project / "deblur_avatar/geometry/planes.py" in closure


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("deblur_avatar/pipeline/cut.py", "import numpy\n", "# why\nimport   numpy  # what\n\n\n"),
        ("deblur_avatar/pipeline/cut.py", '"""Cut it."""', '"""Cut it, and well."""'),
        ("deblur_avatar/pipeline/cut.py", '"""Cut it."""', '"a docstring"; "edge.cpp"'),
        ("deblur_avatar/pipeline/cut.py", '"""Cuts."""\n', ""),
        ("deblur_avatar/pipeline/cut.py", "cut(x, y)", "cut(\n    x,\n    y,\n)"),
        ("deblur_avatar/pipeline/cut.py", "0.5", "(5e-1)"),
        ("deblur_avatar/pipeline/cut.py", "glue import stick", "glue import paste"),
        ("deblur_avatar/imaging/native/edge.cpp", "// twice", "/* two\n// times */"),
        ("deblur_avatar/imaging/native/edge.cpp", "{ return 1; }", "\n{\n\treturn 1 ;\n}\n"),
        ("deblur_avatar/imaging/native/edge.cpp", "((x) + (x))", "\\\n  ((x)+(x))"),
        ("deblur_avatar/imaging/native/steel.h", "float", "// of what\nfloat"),
    ],
)
def test_prose_and_layout_move_no_fingerprint(project, file, old, new):
    assert moved(project, file, old, new) == set()


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("deblur_avatar/pipeline/cut.py", "0.5", "0.25"),
        ("deblur_avatar/pipeline/cut.py", "0.5", "None"),
        ("deblur_avatar/pipeline/cut.py", ":>{y}", ":<{y}"),
        ("deblur_avatar/pipeline/cut.py", "sharpen, 0.5", "sharpen or 0.5"),
        ("deblur_avatar/imaging/native/edge.cpp", "return 1", "return 2"),
        ("deblur_avatar/imaging/native/edge.cpp", "TWICE(x)", "TWICE (x)"),
        ("deblur_avatar/imaging/native/edge.cpp", "int edge", "#endif\nint edge"),
        ("deblur_avatar/imaging/native/steel.h", "1.f", "2.f"),
        ("deblur_avatar/imaging/a.html", "<p>", "<p><!-- a -->"),
        ("stages/cut.py", "import cut", "import cut as slice"),
    ],
)
def test_what_code_does_moves_the_stages_that_run_it(project, file, old, new):
    assert moved(project, file, old, new) == {"cut"}


def test_the_same_code_has_the_same_fingerprint_whatever_python_reads_it(project):
    """Every version here that knows the syntax; one alone if there is no other."""
    module = ROOT / "deblur_avatar/pipeline/code.py"
    show = (
        f"import runpy, json, pathlib; code = runpy.run_path({str(module)!r}); "
        f"here = pathlib.Path({str(project)!r}); "
        "print(json.dumps(code['fingerprints'](here, here)))"
    )
    found = set()
    for name in (sys.executable, "python3.11", "python3.12", "python3.13"):
        if shutil.which(name):
            done = subprocess.run([name, "-c", show], capture_output=True, text=True, check=False)
            found |= {done.stdout} if done.returncode == 0 else set()  # a shim of what is not there
    assert found == {json.dumps(fingerprints(project, project)) + "\n"}


def stages_moved(project, file, old, new, before):
    """Stages that a replaced text makes run again: those that depend on what moves."""
    keys = moved(project, file, old, new, before)
    pipelines = [ROOT / "dvc.yaml", *gathering()]
    return {
        name
        for path in pipelines
        for name, stage in stages(path).items()
        if {key.partition(".")[0] for key in params_of(stage).get("code.json", ())} & keys
    }


def test_a_weight_in_losses_moves_the_stages_that_fit(tmp_path):
    for folder in ("deblur_avatar", "benchmarks", "stages"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    shutil.copy(ROOT / "params.yaml", tmp_path)
    before = fingerprints(tmp_path, tmp_path)
    losses = "deblur_avatar/training/losses.py"
    text = (tmp_path / losses).read_text()
    assert stages_moved(tmp_path, losses, text, f"{text}\n# a comment\n", before) == set()
    assert stages_moved(tmp_path, losses, text, f"{text}\nWEIGHT = 0.5\n", before) == FITTING
    kernel = "deblur_avatar/rendering/kernel.cpp"
    text = (tmp_path / kernel).read_text()
    assert stages_moved(tmp_path, kernel, text, f"// a comment\n{text}", before) == set()
    renders = stages_moved(tmp_path, kernel, text, f"{text}\nint more;\n", before)
    assert renders == FITTING | {
        "evaluate",
        "learning_curve",
        "animate",
        "self_check",
        "export",
    }
    metrics = "deblur_avatar/imaging/metrics.py"
    text = (tmp_path / metrics).read_text()
    scores = stages_moved(tmp_path, metrics, text, f"{text}\nMORE = 0.5\n", before)
    assert not scores & {
        "clip",
        "blur",
        "preprocess",
        "predeblur",
        "warmup",
        "trajectory",
        "fusion",
    }
    assert scores >= {"score_blur", "score_predeblur", "evaluate", "learning_curve"}


REGISTRY = (
    'AVATARS = Registry({{"ball": "deblur_avatar.avatars.ball:Ball"{more}}})\n'
    'OTHER = {{"ball": "no place"}}\n'
)


@pytest.fixture
def with_kinds(project):
    """A stage that runs any kind of avatar, of which there is one; parameters ask for it."""
    files = {
        "stages/cut.py": "from deblur_avatar.avatars.kinds import AVATARS\n",
        "deblur_avatar/avatars/__init__.py": "",
        "deblur_avatar/avatars/kinds.py": REGISTRY.format(more=""),
        "deblur_avatar/avatars/ball.py": "from deblur_avatar.geometry import planes\n",
        "deblur_avatar/avatars/cube.py": "SIDE = 1\n",
        "params.yaml": (
            "from: {avatars: shared/params.yaml, methods: params.yaml}\n"
            "methods: {far: {trajectory: {motion: {kind: none}}}, none: 3}\n"
        ),
        "shared/params.yaml": "avatars: {a: {model: {kind: ball}}, b: {model: {kind: ball}}}\n",
    }
    for name, text in files.items():
        (project / name).parent.mkdir(exist_ok=True)
        (project / name).write_text(text)
    return project


def test_a_kind_has_a_fingerprint_of_its_own_by_the_entries_that_ask_for_it(with_kinds):
    said = fingerprints(with_kinds, with_kinds)
    assert said["avatars"]["a"] == said["avatars"]["b"] != NO_SUCH_KIND
    assert said["methods"] == {"far": NO_SUCH_KIND, "none": NO_SUCH_KIND}
    assert moved(with_kinds, "deblur_avatar/avatars/ball.py", "planes", "curves") == {"avatars"}
    assert moved(with_kinds, "deblur_avatar/geometry/planes.py", "math", "cmath") == {
        "avatars",
        "sew",
    }


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("params.yaml", "[avatars, methods]", "params.yaml must hold sections, got ['avatars', "),
        ("params.yaml", "", "params.yaml must hold sections, got None"),
        ("params.yaml", "from: here", "params.yaml: from: value: input should be a valid dict"),
        ("params.yaml", "from: {avatars: [a]}", "params.yaml: from.avatars: value: input should"),
        ("shared/params.yaml", "a", "shared/params.yaml must hold sections, got 'a'"),
        ("shared/params.yaml", "avatars: [a]", "shared/params.yaml: avatars: value: input should"),
    ],
)
def test_parameters_that_hold_no_sections_are_refused(with_kinds, file, text, message):
    (with_kinds / file).write_text(text)
    with pytest.raises(ConfigError, match=re.escape(message)):
        fingerprints(with_kinds, with_kinds)


@pytest.mark.parametrize("text", ["from:", "seed: 0", "from: {bodies: params.yaml}"])
def test_parameters_that_place_no_kinds_ask_for_none(with_kinds, text):
    (with_kinds / "params.yaml").write_text(text)
    assert fingerprints(with_kinds, with_kinds)["avatars"] == {}


def test_a_new_kind_moves_nothing_and_another_place_of_one_moves_its_entries(with_kinds):
    registry = "deblur_avatar/avatars/kinds.py"
    old, cube = REGISTRY.format(more=""), ', "cube": "deblur_avatar.avatars.cube:Cube"'
    assert moved(with_kinds, registry, old, REGISTRY.format(more=cube)) == set()
    assert moved(with_kinds, registry, "ball:Ball", "ball:Bowl") == {"avatars"}
    assert moved(with_kinds, registry, "no place", "nowhere") == {"cut"}
    assert moved(with_kinds, "deblur_avatar/avatars/cube.py", "1", "2") == set()
    assert moved(with_kinds, "shared/params.yaml", "b: {model: {kind: ball}}", "") == {"avatars"}


def test_a_kind_of_the_package_moves_only_what_asks_for_it():
    """An edit of `lean`'s avatar leaves every stage of the other, and the other way round."""
    said = fingerprints(ROOT, ROOT)
    assert said["avatars"]["lean"] != said["avatars"]["paper"] == said["avatars"]["released"]
    assert said["methods"]["n3"] == said["methods"]["paper"] != said["methods"]["lean"]
    trajectory = import_closure(ROOT / "stages/trajectory.py", ROOT)
    for kind in ("avatars/plain_avatar.py", "avatars/networks_avatar.py", "motion/clip.py"):
        assert ROOT / "deblur_avatar" / kind not in trajectory


def test_refreshing_writes_fingerprints_and_copies_where_the_pipeline_runs(project):
    (project / "dvc.yaml").write_text("stages:\n  code:\n    cmd: new\n")
    for folder, text in (("copy", "stages:\n  code:\n    cmd: old\n"), ("other", "stages: {}\n")):
        (project / "experiments" / folder).mkdir(parents=True)
        (project / "experiments" / folder / "dvc.yaml").write_text(text)
    names = ["code.json", "experiments/copy/dvc.yaml", "experiments/copy/code.json"]
    assert refresh(project) == [project / name for name in names]
    assert json.loads((project / "code.json").read_text()) == fingerprints(project, project)
    assert "new" in (project / "experiments/copy/dvc.yaml").read_text()
    assert refresh(project) == []


def test_scripts_by_themselves_have_the_fingerprints_of_the_installed_package(tmp_path):
    shutil.copytree(ROOT / "stages", tmp_path / "stages")
    ours = fingerprints(ROOT, ROOT)
    assert fingerprints(tmp_path, ROOT) == {name: ours[name] for name in ours if name not in SUITE}


def test_what_a_stage_really_loads_is_within_its_closure():
    """The static walk misses nothing that running the imports shows."""
    show = (
        "import runpy, sys; runpy.run_path(sys.argv[1]); "
        "print('\\n'.join(m.__file__ for n, m in sys.modules.items() "
        "if n.split('.')[0] in ('deblur_avatar', 'benchmarks')))"
    )
    for name in ("blur", "stability_report"):
        (script,) = [path for path in scripts(ROOT) if path.stem == name]
        command = [sys.executable, "-c", show, str(script)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        loaded = {Path(line).resolve() for line in done.stdout.split()}
        assert loaded
        assert loaded <= {path.resolve() for path in import_closure(script, ROOT)}
