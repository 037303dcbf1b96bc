"""Tagged unions: sections whose class is found in a registry by the name under one key.

The registry is asked each time a section is read, so that a kind may be added from outside.
"""

from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Generic, TypeVar, cast

from pydantic import GetCoreSchemaHandler, TypeAdapter
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from deblur_avatar.config.section import Params

Kind = TypeVar("Kind")


class Registry(MutableMapping[str, type[Kind]], Generic[Kind]):
    """Kinds by name, each imported when it is first asked for.

    A stage's fingerprint is then of the kinds that it runs, not of all that there are: a new one
    leaves every result as it is (pipeline/code.py).

    Args:
        places: `package.module:Class` by name.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        self._kinds: dict[str, str | type[Kind]] = dict(places)

    def __getitem__(self, name: str) -> type[Kind]:
        kind = self._kinds[name]
        if isinstance(kind, str):
            module, _, attribute = kind.partition(":")
            kind = cast("type[Kind]", getattr(import_module(module), attribute))
            self._kinds[name] = kind
        return kind

    def __setitem__(self, name: str, kind: type[Kind]) -> None:
        self._kinds[name] = kind

    def __delitem__(self, name: str) -> None:
        del self._kinds[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._kinds)

    def __len__(self) -> int:
        return len(self._kinds)

    def __contains__(self, name: object) -> bool:
        return name in self._kinds  # without importing it


@dataclass(frozen=True)
class KindOf:
    """Marks a type as any class of a registry: `Annotated[Source, KindOf("source", SOURCES)]`.

    Args:
        key: of the section, which names the kind.
        registry: classes of parameters by that name, or classes that call theirs `Params`.
    """

    key: str
    registry: Mapping[str, type]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """How pydantic reads such a section."""
        return core_schema.no_info_plain_validator_function(self._section)

    def _section(self, value: Any) -> Any:
        known = ", ".join(self.registry)
        if isinstance(value, Params):
            name = getattr(value, self.key, None)
        elif isinstance(value, dict) and self.key in value:
            name = value[self.key]
        else:
            raise PydanticCustomError(
                "kind", "wanted a section with the key {key} ({known})",
                {"key": self.key, "known": known},
            )  # fmt: skip
        if not isinstance(name, str) or name not in self.registry:
            raise PydanticCustomError(
                "kind", "no {key} of this name, there is {known}",
                {"key": self.key, "known": known},
            )  # fmt: skip
        kind = self.registry[name]
        return TypeAdapter(getattr(kind, "Params", kind)).validate_python(value)
