"""Registry of bodies: what every kind does, and the kinds by name (`bodies.<name>.source`)."""

from typing import Annotated, Protocol, runtime_checkable

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.anny import AnnyBodyParams
from deblur_avatar.bodies.smpl import SmplBodyParams
from deblur_avatar.config.kinds import KindOf


@runtime_checkable
class BodySource(Protocol):
    """A section of `bodies`: its parameters, with two methods."""

    def build(self) -> Body:
        """Bake or read the body.

        Raises:
            ConfigError: for a file that is missing or has fewer shape numbers than asked for.
            ArtifactError: if the file is damaged or holds another model.
        """
        ...

    def missing_files(self, where: str) -> tuple[str, ...]:
        """What of its files this machine lacks, a reason each, naming the section's key `where`."""
        ...


BODIES: dict[str, type[BodySource]] = {"anny": AnnyBodyParams, "smpl": SmplBodyParams}

BodyParams = Annotated[BodySource, KindOf("source", BODIES)]
