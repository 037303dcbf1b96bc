"""Which body a person has: the stage `body`."""

from pathlib import Path

from deblur_avatar.artifacts import Body
from deblur_avatar.avatar.anny_body import bake_anny
from deblur_avatar.avatar.smpl_files import DOWNLOAD_PAGE, read_smpl
from deblur_avatar.config import AnnyBodyParams, SmplBodyParams, expand_environment


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
