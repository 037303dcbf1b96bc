"""What `import deblur_avatar` offers, and docs/library.md's example of it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import deblur_avatar
from deblur_avatar.errors import ArtifactError, ConfigError

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs/library.md"


@pytest.fixture
def folder(tmp_path, monkeypatch, painted, body):
    """A folder with an avatar and its body where `make repro` puts them."""
    painted(count=400).to_artifact(1).save(tmp_path / "data/fusion/studio-lean/avatar")
    body.save(tmp_path / "data/body/anny")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_example_of_the_documentation_runs(folder):
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    assert len(blocks) == 5
    names: dict = {}
    for block in blocks:
        exec(block, names)
    image, alpha = names["image"], names["alpha"]
    assert image.shape == (1, 256, 256, 3)
    assert float(alpha.amax()) > 0.5
    rows = torch.nonzero(alpha[0].amax(1) > 0.5).flatten()
    assert 10 < int(rows.min()) < int(rows.max()) < 246  # upright, whole and in the middle
    left, right = (alpha[0, :60, side].sum() for side in (slice(160, 256), slice(0, 96)))
    assert left > 2 * right  # the arm that was raised
    assert names["drawn"].image.shape == (1, 256, 256, 3)
    assert names["frames"].shape == (13, 128, 128, 3)
    lit = names["frames"].amax(-1) > 60
    assert bool(lit.any(1).any(1).all())
    assert int(lit[..., 0].sum()) == 0  # framed with a margin


def test_importing_the_package_imports_nothing_of_it():
    program = (
        "import sys, deblur_avatar\n"
        "print([name for name in sys.modules if name.startswith(('deblur_avatar.', 'torch'))])\n"
        "print(sorted(set(deblur_avatar.__all__) - set(dir(deblur_avatar))))\n"
        "print(deblur_avatar.rasterize.__module__, deblur_avatar.__version__)"
    )
    environment = {"PATH": "", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment
    )
    loaded, lacking, rest = done.stdout.splitlines()
    assert (loaded, lacking) == ("[]", "[]")
    assert rest.startswith("deblur_avatar.rendering.rasterize ")


@pytest.mark.parametrize("name", deblur_avatar.__all__)
def test_every_name_of_the_front_door_is_there_and_documented(name):
    assert getattr(deblur_avatar, name).__doc__
    if not name.startswith("__"):
        assert f"deblur_avatar.{name}" in DOCUMENT.read_text() or name == "Poses"


def test_other_names_are_no_attributes():
    with pytest.raises(AttributeError, match="has no attribute 'magic'"):
        deblur_avatar.magic  # noqa: B018


def test_what_is_not_there_is_one_clear_error(folder):
    with pytest.raises(ArtifactError, match="nowhere"):
        deblur_avatar.load_avatar("nowhere", body="data/body/anny")
    avatar = deblur_avatar.load_avatar("data/fusion/studio-lean/avatar", body="data/body/anny")
    with pytest.raises(ConfigError, match="no built-in motion 'polka'"):
        deblur_avatar.animate(avatar, "builtin:polka")


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("fps", 0.0, "above 0"),
        ("start", -0.5, "0 or more"),
        ("seconds", -1.0, "0 or more"),
        ("seconds", float("inf"), "0 or more"),
        ("size", 0, "1 or more"),
    ],
)
def test_a_number_out_of_range_is_one_clear_error(folder, name, value, wanted):
    avatar = deblur_avatar.load_avatar("data/fusion/studio-lean/avatar", body="data/body/anny")
    with pytest.raises(ConfigError, match=f"{name}: wanted a finite number, {wanted}, got {value}"):
        deblur_avatar.animate(avatar, "builtin:jumping_jacks", **{name: value})
