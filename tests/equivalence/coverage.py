"""Which kinds there are, by the classes of parameters, and which of them small cases run.

A kind is a name in a registry (`KindOf`) or one of the words that a parameter may be (`Literal`).
"""

import types
import typing
from collections.abc import Iterable, Iterator
from typing import Any, Literal

import deblur_avatar.parameters  # noqa: F401, which knows the classes of all sections
from deblur_avatar.avatars.kinds import AVATARS
from deblur_avatar.config.kinds import KindOf
from deblur_avatar.config.section import Params
from deblur_avatar.motion.kinds import KINDS
from tests.equivalence.cases import Job

# Not parameters of any stage: a run's observations are a folder of its command.
PATHS = ("deblur_avatar.config.runs", "deblur_avatar.config.proof")

Kind = tuple[str, str]  # a key and what it may be

# Poses of a sequence that are estimated need a person whom a detector finds; two sources have one.
# Persons of 48 pixels fail the check, and a stage that ends for it has nothing to compare.
NOT_IN_SMALL: frozenset[Kind] = frozenset({("poses", "none"), ("on_failure", "stop")})


def kinds() -> set[Kind]:
    """All that a section of `params.yaml` may be, by key."""
    found: set[Kind] = set()
    for registry in (AVATARS, KINDS):
        list(registry.values())  # imports all, so that their sections are known
    for section in _sections(Params):
        for name, kind in typing.get_type_hints(section, include_extras=True).items():
            found |= set(_kinds_in(kind, name))
    return found


def _sections(above: type[Params]) -> Iterator[type[Params]]:
    """Classes of what stages read; none that tests or other commands bring along."""
    for section in above.__subclasses__():
        module = section.__module__
        if module.startswith("deblur_avatar.") and not module.startswith(
            (*PATHS, "deblur_avatar.exports")
        ):
            yield section
        yield from _sections(section)


def _kinds_in(kind: Any, name: str) -> Iterator[Kind]:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Literal:
        yield from ((name, str(word)) for word in arguments)
    elif origin is typing.Annotated:
        for mark in arguments[1:]:
            if isinstance(mark, KindOf):
                yield from ((mark.key, word) for word in mark.registry)
        yield from _kinds_in(arguments[0], name)
    elif isinstance(kind, types.UnionType) or origin is not None:
        for part in arguments:
            yield from _kinds_in(part, name)


def exercised(jobs: Iterable[Job]) -> set[Kind]:
    """What the parameters of these jobs say, by key."""
    return {(key, value) for job in jobs for key, value in job.words}


def uncovered(jobs: Iterable[Job]) -> set[Kind]:
    """Kinds that no job runs."""
    return kinds() - exercised(jobs) - NOT_IN_SMALL
