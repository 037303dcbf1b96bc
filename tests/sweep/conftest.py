"""Repositories that sweeps are tried in."""

from pathlib import Path

import pytest

from tests.sweep.small_sweep import begin_project


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """One with nothing run, to be copied."""
    root: Path = tmp_path_factory.mktemp("made")
    begin_project(root)
    return root
