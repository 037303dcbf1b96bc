"""Which body a person has: the stage `body`."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.anny import AnnyBodyParams, bake_anny
from deblur_avatar.bodies.smpl import DOWNLOAD_PAGE, SmplBodyParams, read_smpl
from deblur_avatar.config.reading import expand_environment

BodyParams = Annotated[AnnyBodyParams | SmplBodyParams, Field(discriminator="source")]


def build_body(params: AnnyBodyParams | SmplBodyParams) -> Body:
    """Bake the default body, or read a licensed one from its file.

    Raises:
        ConfigError: if the file is missing, its name holds a variable that is not set, or it has
            fewer shape directions than asked for.
        ArtifactError: if the file is damaged or holds another model.
    """
    if isinstance(params, AnnyBodyParams):
        return bake_anny(params.shape_components)
    where = "bodies: file (an SMPL model, from " + DOWNLOAD_PAGE + "; or use the body anny)"
    return read_smpl(Path(expand_environment(params.file, where)), params.shape_components)
