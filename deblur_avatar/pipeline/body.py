"""Body baking: which body a person has."""

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.registry import BodyParams, BodySource

__all__ = ["BodyParams", "build_body"]


def build_body(source: BodySource) -> Body:
    """Bake the default body, or read a licensed one from its file.

    Raises:
        ConfigError: if the file is missing, its name holds a variable that is not set, or it has
            fewer shape directions than asked for.
        ArtifactError: if the file is damaged or holds another model.
    """
    return source.build()
