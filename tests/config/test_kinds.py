"""Registries of kinds: imported when asked for, by the name that the class calls itself."""

import subprocess
import sys

import pytest

from deblur_avatar.avatars.kinds import AVATARS
from deblur_avatar.config.kinds import Registry
from deblur_avatar.motion.kinds import KINDS


def test_a_kind_is_imported_when_it_is_asked_for_and_no_sooner():
    show = (
        "import sys; from deblur_avatar.motion.kinds import KINDS; "
        "clip = 'deblur_avatar.motion.clip'; before = clip in sys.modules; "
        "'clip' in KINDS, list(KINDS), len(KINDS); between = clip in sys.modules; "
        "KINDS['clip']; print(before, between, clip in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False", "True"]


@pytest.mark.parametrize("registry", [AVATARS, KINDS])
def test_a_class_calls_itself_what_the_registry_calls_it(registry):
    assert {name: kind.kind for name, kind in registry.items()} == {name: name for name in registry}


def test_kinds_come_and_go():
    registry: Registry[object] = Registry({"number": "builtins:int"})
    registry["text"] = str
    assert dict(registry) == {"number": int, "text": str}
    del registry["number"]
    assert list(registry) == ["text"]
    with pytest.raises(KeyError, match="number"):
        registry["number"]
    with pytest.raises(AttributeError, match="no_such_class"):
        Registry({"lost": "builtins:no_such_class"})["lost"]
