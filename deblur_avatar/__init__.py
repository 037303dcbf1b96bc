"""Sharp, animatable Gaussian avatars from motion-blurred video.

Set `DEBLUR_AVATAR_CHECK_SHAPES=1` before importing to check every annotated tensor shape and
dtype on every call (about 50 microseconds a call: on in the tests, off in timed runs).
"""

import os

if os.environ.get("DEBLUR_AVATAR_CHECK_SHAPES") == "1":
    from jaxtyping import install_import_hook

    # Artifacts check themselves and raise errors of their own, so they stay outside the hook.
    _CHECKED = (
        "geometry", "imaging", "rendering", "bodies", "motion", "avatars", "training",
        "body_estimation", "sources", "animation", "evaluation", "reporting", "pipeline",
    )  # fmt: skip
    install_import_hook([f"{__name__}.{name}" for name in _CHECKED], "beartype.beartype")
