"""Which files of this repository a stage script runs; writes them into the dvc.yaml files.

    python -m tests.structure.import_closure --write

The walk is static: every `import` statement counts, those inside functions too, and so does every
package's `__init__.py` on the way. A file that is no Python module (a kernel's source, a template)
belongs to the module that stands beside it and names it in a string. A folder of which everything
is needed is listed as the folder, so that dvc.lock stays short.
"""

import argparse
import ast
import sys
from collections.abc import Iterator
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.scalarstring import ScalarString

from tests.structure.experiments import experiments, write_pipelines

ROOT = Path(__file__).parents[2]
PACKAGE = "deblur_avatar"
PIPELINE = "dvc.yaml"
CODE = (f"{PACKAGE}/", f"{PACKAGE}", "stages/")
IGNORED = ("__pycache__",)


def import_closure(script: Path, root: Path = ROOT) -> set[Path]:
    """All files of the package that running `script` may import, and what they read beside them."""
    found: set[Path] = set()
    waiting = [script]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        if path.suffix == ".py":
            tree = ast.parse(path.read_text(), path)
            waiting += [*_imported(tree, path, root), *_named_beside(tree, path)]
    return found


def code_dependencies(script: Path, root: Path = ROOT) -> list[str]:
    """The closure as DVC should list it: the script first, then folders and files in order."""
    closure = import_closure(script, root)
    names = _collapsed({path for path in closure if path != script}, root / PACKAGE)
    return [str(script.relative_to(root)), *sorted(str(path.relative_to(root)) for path in names)]


def expanded(dependencies: list[str], root: Path = ROOT) -> set[Path]:
    """The files that a list of dependencies on code stands for."""
    files: set[Path] = set()
    for name in dependencies:
        path = root / name
        files |= set(_files(path)) if path.is_dir() else {path}
    return files


def is_code(dependency: str) -> bool:
    """True for dependencies that this module writes."""
    return dependency.startswith(CODE[0]) or dependency.startswith(CODE[2]) or dependency == CODE[1]


def stages(root: Path = ROOT) -> dict[str, CommentedMap]:
    """The stages of the pipeline by name, without their `foreach`."""
    content = _yaml().load(root / PIPELINE)
    return {name: stage.get("do", stage) for name, stage in content["stages"].items()}


def script_of(stage: CommentedMap, root: Path = ROOT) -> Path:
    """The script that a stage's command runs."""
    words = str(stage["cmd"]).split()
    return root / next(word for word in words if word.startswith("stages/"))


def own_pipelines(root: Path = ROOT) -> list[Path]:
    """The pipelines written by hand: the root's, those that gather experiments, the suite's."""
    made = {folder / PIPELINE for folder in experiments(root)}
    gathering = sorted(set((root / "experiments").glob(f"*/{PIPELINE}")) - made)
    return [root / PIPELINE, *gathering, *sorted((root / "stability").rglob(PIPELINE))]


def write_dependencies(root: Path = ROOT, path: Path | None = None) -> list[str]:
    """Bring a dvc.yaml's lists of code up to date; returns the names of the stages that changed."""
    yaml = _yaml()
    path = root / PIPELINE if path is None else path
    content = yaml.load(path)
    changed = []
    for name, entry in content["stages"].items():
        stage = entry.get("do", entry)
        code = code_dependencies(script_of(stage, root), root)
        before = stage.get("deps") or []
        after = [*code, *(dep for dep in before if not is_code(str(dep)))]
        if list(map(str, before)) != list(map(str, after)):
            stage["deps"] = _block(after)
            changed.append(name)
    if changed:
        yaml.dump(content, path)
    return changed


def _imported(tree: ast.AST, path: Path, root: Path) -> Iterator[Path]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _module_files(alias.name, root)
        elif isinstance(node, ast.ImportFrom):
            package = _absolute(node, path, root)
            yield from _module_files(package, root)
            for alias in node.names:
                yield from _module_files(f"{package}.{alias.name}", root)


def _absolute(node: ast.ImportFrom, path: Path, root: Path) -> str:
    if node.level == 0:
        return node.module or ""
    parts = path.relative_to(root).parts[: -node.level]
    return ".".join([*parts, *([node.module] if node.module else [])])


def _module_files(name: str, root: Path) -> Iterator[Path]:
    """The module's file and every `__init__.py` above it; nothing for names outside the package."""
    parts = name.split(".")
    if parts[0] != PACKAGE:
        return
    for depth in range(1, len(parts) + 1):
        here = root.joinpath(*parts[:depth])
        if (here / "__init__.py").is_file():
            yield here / "__init__.py"
        elif here.with_suffix(".py").is_file():
            yield here.with_suffix(".py")


def _named_beside(tree: ast.AST, path: Path) -> Iterator[Path]:
    names = {path.name for path in path.parent.iterdir() if path.is_file() and path.suffix != ".py"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and node.value in names:
            yield path.parent / str(node.value)


def _collapsed(files: set[Path], folder: Path) -> set[Path]:
    """Folders all of whose files are there stand for them."""
    inside = {path for path in files if path.is_relative_to(folder)}
    if inside and inside == set(_files(folder)):
        return {folder}
    direct = {path for path in inside if path.parent == folder}
    deeper = [
        _collapsed(inside, child)
        for child in sorted(folder.iterdir())
        if child.is_dir() and child.name not in IGNORED
    ]
    return direct.union(*deeper)


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        if path.is_file() and not set(path.relative_to(folder).parts) & set(IGNORED):
            yield path


def _block(values: list[str]) -> CommentedSeq:
    sequence = CommentedSeq(
        value if isinstance(value, ScalarString) else str(value) for value in values
    )
    sequence.fa.set_block_style()
    return sequence


def _yaml() -> YAML:
    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 100
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml


def main() -> int:
    """Write the lists, or with no option say which stages are out of date (exit code 1)."""
    parser = argparse.ArgumentParser(description=write_dependencies.__doc__)
    parser.add_argument("--write", action="store_true", help="change dvc.yaml")
    if parser.parse_args().write:
        changed = [name for path in own_pipelines() for name in write_dependencies(path=path)]
        changed += write_pipelines()
        sys.stdout.write(f"dvc.yaml: {', '.join(changed) or 'nothing'} changed\n")
        return 0
    wrong = []
    for name, stage in stages().items():
        declared = [str(dep) for dep in stage.get("deps") or [] if is_code(str(dep))]
        if declared != code_dependencies(script_of(stage)):
            wrong.append(name)
    sys.stdout.write(f"dvc.yaml: {', '.join(wrong) or 'nothing'} out of date\n")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
