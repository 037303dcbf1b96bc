"""Sharp, animatable Gaussian avatars from motion-blurred video.

The library's front door: the names of `__all__`, each loaded when it is first asked for, so that
importing the package costs nothing. docs/library.md shows them at work.

Set `DEBLUR_AVATAR_CHECK_SHAPES=1` before importing to check every annotated tensor shape and
dtype on every call (about 50 microseconds a call: on in the tests, off in timed runs).
"""

import importlib
import os
from typing import Any

# Threads that wait for others sleep: where another process needs the cores, those that spin make a
# fit thirty times slower. OpenMP reads this once, when torch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

if os.environ.get("DEBLUR_AVATAR_CHECK_SHAPES") == "1":
    from jaxtyping import install_import_hook

    # Artifacts check themselves and raise errors of their own, so they stay outside the hook.
    _CHECKED = (
        "geometry", "imaging", "rendering", "bodies", "motion", "avatars", "training",
        "body_estimation", "sources", "animation", "exports", "library", "evaluation",
        "reporting", "pipeline",
    )  # fmt: skip
    install_import_hook([f"{__name__}.{name}" for name in _CHECKED], "beartype.beartype")

# Where each name comes from: module and attribute. Not imported here, so that what a stage runs
# stays what it imports itself.
_FRONT_DOOR = {
    "rasterize": ("rendering.rasterize", "rasterize"),
    "load_avatar": ("library", "load_avatar"),
    "rest_pose": ("library", "rest_pose"),
    "render": ("avatars.render", "render_avatar"),
    "pose": ("exports.posed_gaussians", "posed_gaussians"),
    "animate": ("library", "animate"),
    "Poses": ("artifacts.poses", "Poses"),
    "Camera": ("geometry.cameras", "Camera"),
}

__all__ = [
    "Camera", "Poses", "__version__", "animate", "load_avatar", "pose", "rasterize", "render",
    "rest_pose",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load a name of the front door."""
    if name == "__version__":
        from importlib.metadata import version

        return version("deblur-avatar")
    if name not in _FRONT_DOOR:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _FRONT_DOOR[name]
    return getattr(importlib.import_module(f"{__name__}.{module}"), attribute)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
