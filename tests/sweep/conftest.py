"""Repositories that sweeps are tried in."""

from pathlib import Path

import pytest

from tests.structure.small_repository import commit
from tests.sweep.small_sweep import MORE, begin_project, called, copied


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """One with nothing run, to be copied."""
    root: Path = tmp_path_factory.mktemp("made")
    begin_project(root)
    return root


@pytest.fixture(scope="session")
def serial(made, tmp_path_factory) -> Path:
    """The same after `dvc repro`, one stage after the other, and a commit; to be copied, too."""
    root = copied(made, tmp_path_factory.mktemp("serial") / "one")
    called(root, "dvc", "repro", "dvc.yaml", f"{MORE}/dvc.yaml")
    commit(root)
    return root
