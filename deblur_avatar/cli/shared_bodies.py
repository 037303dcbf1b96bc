"""Shared bodies: what one folder has baked, every other folder of the same user takes.

Baking takes a minute or two and gives the same bytes each time. So folders that an installed
package makes have a DVC remote in common, in the user's cache: it holds bodies, and DVC's run cache
says which code and parameters each was baked with. Nothing else is sent there: no folder's settings
name it, which are its user's alone. Each folder has its own copy, so that the cache may be deleted
at any time.
"""

import logging
from pathlib import Path

from deblur_avatar.cli.locked_stages import locked_stage
from deblur_avatar.cli.running_dvc import push, reproduce_from
from deblur_avatar.rendering.native_build import cache_folder

logger = logging.getLogger(__name__)

BODIES = "bodies"  # of the cache


def make_body(folder: Path, name: str) -> int:
    """Have DVC take a folder's body from the user's cache, or bake it and put it there.

    A cache that cannot be written is said, and done without.

    Args:
        folder: an independent home, installed.
        name: of its entry in `bodies`.

    Returns:
        0, or another exit code if there is no body.
    """
    cache = cache_folder().resolve() / BODIES
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        logger.warning("The body is not shared with other folders: %s", error)
        return 0
    stage, made = f"body@{name}", folder / "data/body" / name
    if made.exists() and _is_shared(folder, name, cache):
        return 0
    code = reproduce_from(cache, stage, folder)
    if code == 0 and not _is_shared(folder, name, cache) and push(cache, stage, folder) != 0:
        logger.warning("The body is not shared with other folders: DVC cannot write %s", cache)
    return code


def _is_shared(folder: Path, name: str, cache: Path) -> bool:
    """Whether the body that the folder was given last lies in the cache, and how it was baked.

    Other code may bake the same bytes: folders find them by what DVC remembers of that run. Where
    it cannot be told a body is sent again, which changes nothing.
    """
    digest = locked_stage(folder, f"body@{name}").left(f"data/body/{name}")
    if digest is None:
        return False
    known = folder / ".dvc/cache/runs"
    # Those that it came out of, not those that read it.
    made = [run for run in known.glob("*/*/*") if digest in _outputs(run.read_text())]
    return (cache / "files/md5" / digest[:2] / digest[2:]).is_file() and all(
        (cache / "runs" / run.relative_to(known)).is_file() for run in made
    )


def _outputs(run: str) -> str:
    """What DVC's file of a run, whose keys are in order, says of outputs."""
    return run.partition("\nouts:")[2]
