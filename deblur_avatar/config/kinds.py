"""Tagged unions: sections whose class is found in a registry by the name under one key.

The registry is asked each time a section is read, so that a kind may be added from outside.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler, TypeAdapter
from pydantic_core import CoreSchema, PydanticCustomError, core_schema


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
        classes = {name: getattr(kind, "Params", kind) for name, kind in self.registry.items()}
        if isinstance(value, tuple(classes.values())):
            return value
        known = ", ".join(self.registry)
        if not isinstance(value, dict) or self.key not in value:
            raise PydanticCustomError(
                "kind", "wanted a section with the key {key} ({known})",
                {"key": self.key, "known": known},
            )  # fmt: skip
        name = value[self.key]
        if not isinstance(name, str) or name not in self.registry:
            raise PydanticCustomError(
                "kind", "no {key} of this name, there is {known}",
                {"key": self.key, "known": known},
            )  # fmt: skip
        return TypeAdapter(classes[name]).validate_python(value)
