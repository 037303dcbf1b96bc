"""What a module with a native kernel does on a machine without a compiler."""

from types import ModuleType

import pytest

from deblur_avatar.rendering import native_build
from deblur_avatar.rendering.native_build import BuildError


def check_a_warning_without_a_compiler(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has no library, and warns with the reason; one that it has loaded before stays."""

    def fail(*source_and_defines: object) -> None:
        raise BuildError("no C++ compiler")

    monkeypatch.setattr(native_build, "load_library", fail)
    with pytest.warns(UserWarning, match="plain torch, slowly: no C"):
        library = module._library.__wrapped__()
    assert library is None
