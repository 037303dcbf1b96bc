"""No way in is forgotten: every function that reads files is run by a reader of the registry."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "deblur_avatar"
READS = {
    "read_text", "read_bytes", "open", "fromfile", "load_file", "safe_open", "imread", "memmap",
    "loadtxt", "genfromtxt", "VideoCapture", "ZipFile", "mmap",
}  # fmt: skip
LOADERS = {"np", "torch", "pickle", "json", "tomllib", "yaml", "joblib", "trimesh"}
OWN = "reads what came with the code"
EXEMPT = {
    "pipeline/ablations.py:_page": OWN,
    "pipeline/check_pictures.py:check_page": OWN,
    **{
        f"pipeline/code.py:{name}": OWN
        for name in ("fingerprint", "refresh", "pipelines", "_neighbours")
    },
    "pipeline/report.py:_animations": "puts a video of our own into a page without looking inside",
    "pipeline/report.py:_page": OWN,
    "pipeline/reproduce.py:main": "prints a table of our own",
    "pipeline/speed_accuracy.py:chart": OWN,
    "pipeline/stability_report.py:_page": OWN,
    "imaging/rasterizers/native_build.py:_key": OWN,
    "imaging/rasterizers/native_build.py:_processor": "reads what the kernel says",
    "fitting/run_folder.py:run_folder": "a lock, which has no content",
    "fitting/run_folder.py:run_key": "counts bytes without looking at what they mean",
}


def functions_that_read(tree: ast.AST) -> Iterator[str]:
    """Names of the innermost functions with a call that opens a file to read it."""
    for parent in ast.walk(tree):
        if isinstance(parent, ast.FunctionDef):
            nested = {id(n) for f in _nested(parent) for n in ast.walk(f)}
            calls = (n for n in ast.walk(parent) if isinstance(n, ast.Call) and id(n) not in nested)
            if any(_reads(call) for call in calls):
                yield parent.name


def _nested(function: ast.FunctionDef) -> list[ast.AST]:
    return [n for n in ast.walk(function) if isinstance(n, ast.FunctionDef) and n is not function]


def _reads(call: ast.Call) -> bool:
    owner, _, name = ast.unparse(call.func).rpartition(".")
    if name == "open":
        modes = [a.value for a in call.args if isinstance(a, ast.Constant)]
        return not any(
            isinstance(mode, str) and len(mode) < 4 and set(mode) & set("wax") for mode in modes
        )
    loads = name == "load" and (owner in LOADERS or "YAML(" in owner)
    return loads or name in READS or (name == "parse" and "ElementTree" in owner)


def _found() -> set[str]:
    return {
        f"{path.relative_to(PACKAGE)}:{name}"
        for path in PACKAGE.rglob("*.py")
        for name in functions_that_read(ast.parse(path.read_text()))
    }


def test_every_function_that_reads_files_is_run_by_a_reader_of_the_registry(sample):
    run = {name for row in sample.values() for name in row["functions"]}
    missing = _found() - run - set(EXEMPT)
    assert not missing, "add a reader to tests/fuzz/readers.py"
    assert not set(EXEMPT) - _found(), "these read nothing any more"


def test_every_artifact_has_a_reader(sample):
    schemas = {
        statement.value.value
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef) and [ast.unparse(b) for b in node.bases] == ["Artifact"]
        for statement in node.body
        if isinstance(statement, ast.AnnAssign) and ast.unparse(statement.target) == "schema"
    }
    assert len(schemas) > 5
    assert {f"artifact {schema}" for schema in schemas} <= set(sample)


def test_scripts_leave_reading_to_the_package():
    for path in (ROOT / "stages").glob("*.py"):
        assert not list(functions_that_read(ast.parse(path.read_text()))), path


def test_reading_is_told_from_writing():
    text = "def f(p):\n    {}\n"
    for call in (
        "p.read_text()",
        "np.load(p)",
        "open(p)",
        "p.open('rb')",
        "YAML(typ='safe').load(p)",
    ):
        assert list(functions_that_read(ast.parse(text.format(call)))) == ["f"], call
    for call in ("p.open('w')", "open(p, 'wb')", "Clip.load(p)", "p.write_text('x')"):
        assert not list(functions_that_read(ast.parse(text.format(call)))), call
