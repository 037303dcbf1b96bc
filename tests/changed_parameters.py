"""Parameters with other values."""

from typing import Any, TypeVar

from deblur_avatar.config.section import Params

P = TypeVar("P", bound=Params)


def changed(params: P, path: str, **values: Any) -> P:
    """The same parameters, but for some values of the section at a dotted path."""
    head, _, rest = path.partition(".")
    section = getattr(params, head)
    if rest:
        new: Any = changed(section, rest, **values)
    elif isinstance(section, dict):
        new = section | values
    else:
        new = section.model_copy(update=values)
    return params.model_copy(update={head: new})
