"""Code fingerprints: hashes over the syntax of all that a stage's script, or a kind, imports.

DVC compares files byte by byte, so that a pipeline whose stages depend on their source files
reruns for a comment. Here a stage depends on one number instead, that only code can move: what
config/syntax.py says of a file.

The walk over imports is static: every `import` counts, those inside functions too, and so does
every package's `__init__.py` on the way, and a module whose full name stands in a string. A file
that is no Python module belongs to the module above it that names it in a string, or to the C++
file that includes it. The walk ends at a registry of kinds (`Registry` of config/kinds.py), whose
kinds have hashes of their own: `code.json` has them by the recipes and methods of the parameter
files that run them, so that an avatar or a trajectory that nobody asks for moves nothing.

Where the root has scripts and no package, as the folder of an avatar made by an installed package,
modules are looked for where the package is installed. Names, and so fingerprints, are the same.
"""

import ast
import hashlib
import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

from deblur_avatar.config.proof import files_of
from deblur_avatar.config.reading import own_sections, parse
from deblur_avatar.config.remembered_code import Hashes, recalled, remember, state_of
from deblur_avatar.config.syntax import CPP, PACKAGES, content_hash, places_of_kinds, stripped
from deblur_avatar.ending import exit_code

SCRIPTS = ("stages", "benchmarks/stress/stages")
AREAS = ("experiments", "avatars")
PROOF = "experiments/proof"
PIPELINE, FINGERPRINTS = "dvc.yaml", "code.json"
PARAMS = "params.yaml"


@dataclass(frozen=True)
class Registered:
    """Kinds that a section of parameters chooses from, an entry each."""

    registry: str  # the module's path
    kind: tuple[str, ...]  # keys of an entry that lead to the kind's name


# By the section, which `from` in a folder's parameters may place in another folder's.
REGISTERED = {
    "avatars": Registered("deblur_avatar/avatars/kinds.py", ("model", "kind")),
    "methods": Registered("deblur_avatar/motion/kinds.py", ("trajectory", "motion", "kind")),
}
NO_SUCH_KIND = "no such kind"  # the stage that reads the entry says what there is
FILE_NAME = re.compile(r"\w[\w-]*(\.\w+)+")


def fingerprints(root: Path, folder: Path) -> dict[str, Any]:
    """What `code.json` of a folder says: the fingerprint of every stage's script by its name, and
    of every recipe's avatar and every method's trajectory.

    Args:
        root: of the repository, or where the scripts lie of a folder made by an installed package.
        folder: whose parameters name recipes and methods; of one without, there are none.

    Raises:
        SyntaxError: if a module is not Python.
        ConfigError: if a parameter file that is there cannot be read.
    """
    return _of_folder(hashes(root, folder), folder)


def hashes(root: Path, folder: Path) -> Hashes:
    """The fingerprints of all code below a root, which every folder's `code.json` chooses from.

    Args:
        root: as for `fingerprints`.
        folder: that remembers them, if DVC has been there.

    Raises:
        SyntaxError: if a module is not Python.
    """
    places = [start / name for start in _starts(root) for name in (*PACKAGES, *SCRIPTS)]
    state = state_of(places)
    found = recalled(folder, state)
    if found is None:
        found = _hashes(root)
        if state_of(places) == state:  # and nobody has edited meanwhile
            remember(folder, state, found)
    return found


def _hashes(root: Path) -> Hashes:
    known: dict[Path, list[Path]] = {}

    def of(path: Path) -> str:
        return fingerprint(import_closure(path, root, known), root)

    return Hashes(
        scripts={script.stem: of(script) for script in scripts(root)},
        kinds={
            section: {
                name: _joint(place, of(module))
                for name, (place, module) in registered(root, chosen.registry).items()
            }
            for section, chosen in REGISTERED.items()
        },
    )


def _of_folder(code: Hashes, folder: Path) -> dict[str, Any]:
    of_entries = {
        section: {
            name: kinds.get(kind, NO_SUCH_KIND)
            for name, kind in kinds_asked_for(folder, section).items()
        }
        for section, kinds in code.kinds.items()
    }
    return {**code.scripts, **of_entries}


def registered(root: Path, registry: str) -> dict[str, tuple[str, Path]]:
    """Where a registry says that each kind is, and the module's file; read, not imported."""
    paths = [start / registry for start in _starts(root) if (start / registry).is_file()]
    found = {}
    for node in ast.walk(ast.parse(paths[0].read_bytes())) if paths else ():
        for name, place in places_of_kinds(node):
            *_, module = _module_files(place.partition(":")[0], root)
            found[name] = (place, module)
    return found


def kinds_asked_for(folder: Path, section: str) -> dict[str, str]:
    """The kind that each entry of a section names, of the file where `from` places the section.

    Raises:
        ConfigError: if one of the two files does not hold sections, or the section no entries.
    """
    path = folder / PARAMS
    places = own_sections(path).get("from") or {} if path.is_file() else {}
    if section not in parse(dict, places, f"{path}: from"):
        return {}
    path = folder / parse(str, places[section], f"{path}: from.{section}")
    entries = parse(dict, own_sections(path).get(section) or {}, f"{path}: {section}")
    return {name: _at(entry, REGISTERED[section].kind) for name, entry in entries.items()}


def _at(entry: Any, keys: tuple[str, ...]) -> str:
    for key in keys:
        entry = entry.get(key) if isinstance(entry, dict) else None
    return str(entry)


def refresh(root: Path) -> list[Path]:
    """Write the fingerprints, and the root's pipeline, into every folder that runs it; and what
    the plan of the proof stands for.

    Returns:
        Files whose content has changed.
    """
    pipeline, code = (root / PIPELINE).read_bytes(), hashes(root, root)
    wanted: dict[Path, bytes] = {}
    for folder in pipelines(root):
        said = f"{json.dumps(_of_folder(code, folder), indent=1)}\n".encode()
        wanted |= {folder / PIPELINE: pipeline, folder / FINGERPRINTS: said}
    if (root / PROOF).is_dir():
        wanted |= files_of(root / PROOF)
    changed = []
    for path, content in wanted.items():
        if not path.is_file() or path.read_bytes() != content:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            changed.append(path)
    return changed


def pipelines(root: Path) -> list[Path]:
    """The root, and all folders below `experiments/` and `avatars/` that run its stages."""
    found = [path for area in AREAS for path in sorted((root / area).rglob(PIPELINE))]
    own = [path.parent for path in found if re.search(rb"^  code:$", path.read_bytes(), re.M)]
    return [root, *own]


def scripts(root: Path) -> list[Path]:
    """The scripts of all stages, in the order of their names."""
    found = [path for folder in SCRIPTS for path in (root / folder).glob("[!_]*.py")]
    return sorted(found, key=lambda path: path.stem)


def fingerprint(files: set[Path], root: Path) -> str:
    """One hash over files' names and what in them can change a result."""
    digest = hashlib.sha256()
    named = {_name(path, root): path for path in files}
    for name, path in sorted(named.items()):
        digest.update(
            f"{name.as_posix()}\0{content_hash(path.suffix, path.read_bytes())}\n".encode()
        )
    return digest.hexdigest()[:32]


def _joint(*said: str) -> str:
    return hashlib.sha256("\0".join(said).encode()).hexdigest()[:32]


def import_closure(
    script: Path, root: Path, known: dict[Path, list[Path]] | None = None
) -> set[Path]:
    """All files of this repository that running `script` may import, and what they read.

    Args:
        script: where to begin.
        root: of the repository.
        known: what each file looked at before leads to; grows, so that scripts can share it.
    """
    known = {} if known is None else known
    found: set[Path] = set()
    waiting = [script]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            if path not in known:
                known[path] = list(_neighbours(path, root))
            waiting += known[path]
    return found


def _neighbours(path: Path, root: Path) -> Iterator[Path]:
    if path.suffix == ".py":
        own = _name(path, root).parts
        imported, files = _references(path.read_bytes(), own[:-1])
        for name in imported:
            yield from _module_files(name, root)
        if own[0] in PACKAGES:
            for name in files:
                yield from path.parent.rglob(name)
    elif path.suffix in CPP:
        for name in re.findall(r'^\s*#\s*include\s*"([^"]+)"', path.read_text(), re.MULTILINE):
            if (path.parent / name).is_file():
                yield Path(os.path.normpath(path.parent / name))  # below the root, as that is given


def _starts(root: Path) -> list[Path]:
    """The folders that names of files are counted from."""
    installed = Path(__file__).parents[2]
    return [root] if (root / PACKAGES[0]).is_dir() else [root, installed]


def _name(path: Path, root: Path) -> Path:
    """A file as it is called from the first folder that it lies below."""
    start = next(start for start in _starts(root) if path.is_relative_to(start))
    return path.relative_to(start)


@lru_cache(maxsize=1024)
def _references(source: bytes, package: tuple[str, ...]) -> tuple[frozenset[str], frozenset[str]]:
    """The full names of what a module may import, and strings that could be names of files."""
    imported: set[str] = set()
    strings: set[str] = set()
    for node in ast.walk(stripped(ast.parse(source))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            name = ".".join([*above, *([node.module] if node.module else [])])
            imported |= {name, *(f"{name}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            strings.add(node.value)
    imported |= {text for text in strings if re.fullmatch(rf"({'|'.join(PACKAGES)})(\.\w+)+", text)}
    files = {text for text in strings if FILE_NAME.fullmatch(text) and not text.endswith(".py")}
    return frozenset(imported), frozenset(files)


def _module_files(name: str, root: Path) -> Iterator[Path]:
    """The module's file and every `__init__.py` above it; nothing for names from elsewhere."""
    parts = name.split(".")
    if parts[0] not in PACKAGES:
        return
    for depth, start in product(range(1, len(parts) + 1), _starts(root)):
        here = start.joinpath(*parts[:depth])
        if (here / "__init__.py").is_file():
            yield here / "__init__.py"
        elif here.with_suffix(".py").is_file():
            yield here.with_suffix(".py")


def main() -> None:
    """Refresh what belongs to the folder that this runs in."""
    changed = ", ".join(map(str, refresh(Path())))
    sys.stdout.write(f"{changed or 'nothing'} changed\n")


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
