"""Sections of weights: one number for each row of a table.

The table is asked each time a section is read, so that a row may be added from outside.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler, TypeAdapter, create_model
from pydantic_core import CoreSchema, core_schema

from deblur_avatar.config.section import NonNegative, Params


@dataclass(frozen=True)
class WeightsOf:
    """Marks a type as weights of a table: `Annotated[Mapping[str, float], WeightsOf(LOSSES)]`."""

    table: Mapping[str, Any]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """How pydantic reads such a section."""
        return core_schema.no_info_plain_validator_function(self._section)

    def _section(self, value: Any) -> dict[str, float]:
        keys: dict[str, Any] = dict.fromkeys(self.table, (NonNegative, ...))
        section = create_model("Weights", __base__=Params, **keys)
        return TypeAdapter(section).validate_python(value).model_dump()
