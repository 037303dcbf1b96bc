"""Strict reading of `params.yaml`, as DVC reads it (YAML 1.2).

Every default lives in `params.yaml`, none in code. Unknown keys, missing keys, wrong types and
values out of range are errors that name the key.
"""

import os
import re
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from ruamel.yaml import YAML

from deblur_avatar.errors import ConfigError

P = TypeVar("P")

MAX_BYTES = 1 << 18  # of a parameter file; the root's has 10 kB, a megabyte takes ten seconds
MAX_SHARED = 8  # files that name each other in turn
KNOWN_BELOW = ("bodies", "scenes")  # sections that, empty, hide nothing of the shared file's

ENVIRONMENT = (
    r"\$\((?P<name>\w+)(?::-(?P<default>[^)]*))?\)",
    r"\$\{(?P<name>\w+)(?::-(?P<default>[^}]*))?\}",
)


def load_params(path: Path, key: str, kind: Any) -> Any:
    """Read one section (`"methods.paper.fusion"`) of a parameter file.

    Raises:
        ConfigError: naming the file, the key, what was wanted and what came.
    """
    return section_of(read_params(path), path, key, kind)


def read_params(path: Path) -> Any:
    """Read a parameter file; sections that it lacks come from the file that its `shared` names.

    That file may name another in turn. Empty `bodies` or `scenes` say that none are made here, not
    that none are known: they come from there too.

    Raises:
        ConfigError: if one of the two is missing or is not YAML, or they name each other.
    """
    return _with_shared(Path(path), 0)


def _with_shared(path: Path, above: int) -> Any:
    if above > MAX_SHARED:
        raise ConfigError(
            f"{path}: shared leads through over {MAX_SHARED} files; does one lead back to another?"
        )
    content = read_yaml(path)
    if not isinstance(content, dict) or "shared" not in content:
        return content
    other = path.parent / parse(str, content["shared"], f"{path}: shared")
    below = _with_shared(other, above + 1)
    if not isinstance(below, dict):
        raise ConfigError(f"{path}: shared: {other} must hold sections, got {below!r:.60}")
    own = {
        key: value
        for key, value in content.items()
        if key != "shared" and not (key in KNOWN_BELOW and value == {})
    }
    return {**below, **own}


def section_of(content: Any, path: Path, key: str, kind: Any) -> Any:
    """Check one section of what a parameter file holds; `path` is named in what is refused.

    Raises:
        ConfigError: naming the key, what was wanted and what came.
    """
    value = content
    for depth, name in enumerate(key.split(".")):
        if not isinstance(value, dict) or name not in value:
            above = ".".join(key.split(".")[:depth]) or "the file"
            known = ", ".join(map(str, value)) if isinstance(value, dict) else "no keys"
            raise ConfigError(f"{path}: {key}: {above} has no key {name!r}, it has {known}")
        value = value[name]
    return parse(kind, value, f"{path}: {key}")


def parse(kind: Any, value: Any, where: str) -> Any:
    """Check one section against its class.

    Raises:
        ConfigError: all complaints at once, each with its key.
    """
    try:
        return TypeAdapter(kind).validate_python(_tuples(value))
    except ValidationError as error:
        complaints = [_complaint(item) for item in error.errors()]
        raise ConfigError(f"{where}: " + "; ".join(complaints)) from None
    except RecursionError:  # an alias within what it stands for
        raise ConfigError(f"{where}: it contains itself, or is nested far too deeply") from None


def expand_environment(text: str, where: str) -> str:
    """Replace `$(VARIABLE)` and `$(VARIABLE:-default)` by what the environment holds.

    Braces do as well, but `dvc exp run -S` refuses files that hold them: it reads them as its own.
    An empty variable counts as unset, as in a shell.

    Raises:
        ConfigError: naming `where`, for a variable that is not set and has no default.
    """

    def value(match: re.Match[str]) -> str:
        found = os.environ.get(match["name"]) or match["default"]
        if found is None:
            raise ConfigError(f"{where}: set the environment variable {match['name']}, it is empty")
        return found

    for pattern in ENVIRONMENT:
        text = re.sub(pattern, value, text)
    return text


def holds_variable(text: str) -> bool:
    """Whether `expand_environment` takes a part of a text for a variable."""
    return any(re.search(pattern, text) for pattern in ENVIRONMENT)


def own_sections(path: Path) -> dict[str, Any]:
    """The sections that stand in a parameter file itself, unchecked.

    Raises:
        ConfigError: if it is missing, is not YAML, or holds no sections.
    """
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ConfigError(f"{path} must hold sections, got {content!r:.60}")
    return content


def missing_file(text: str, where: str, wanted: str, *, folder: bool = False) -> tuple[str, ...]:
    """Why a file that a parameter names cannot be read here: one reason, or none if it is there.

    Args:
        text: the path; may hold `$(VARIABLE:-default)`.
        where: the parameter's key.
        wanted: what should lie there, for the message.
        folder: whether it must be a folder.
    """
    try:
        path = Path(expand_environment(text, where))
    except ConfigError as error:
        return (str(error),)
    there = path.is_dir() if folder else path.exists()
    return () if there else (f"no {wanted} {path} ({where})",)


def read_yaml(path: Path) -> Any:
    """Read a YAML 1.2 file as DVC does (`1e-3` is a number, `no` is a word).

    Raises:
        ConfigError: if it is missing, is not YAML, or is far larger than parameters are.
    """
    try:
        with Path(path).open("rb") as file:
            text = file.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise ConfigError(f"{path} has over {MAX_BYTES >> 10} kB; is it a parameter file?")
        return deepcopy(_yaml(text))
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    except Exception as error:
        # Damaged YAML raises nearly anything from inside ruamel.yaml: a date without a month, say.
        raise ConfigError(f"{path} is not YAML: {error or repr(error)}") from None


@lru_cache(maxsize=8)  # a stage reads its parameters section by section
def _yaml(text: bytes) -> Any:
    return YAML(typ="safe", pure=True).load(text)


def _tuples(value: Any) -> Any:
    """Lists become tuples, so that parsed sections are immutable all the way down."""
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    return value


def _complaint(item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"]) or "value"
    if item["type"] == "extra_forbidden":
        return f"unknown key {key!r}"
    if item["type"] == "missing":
        return f"missing key {key!r}"
    if item["type"] == "union_tag_not_found":
        return f"missing key {item['ctx']['discriminator']}, which names the kind"
    return f"{key}: {item['msg'][0].lower() + item['msg'][1:]}, got {item['input']!r:.200}"
