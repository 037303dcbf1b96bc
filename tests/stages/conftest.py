from collections.abc import Iterator

import pytest

from tests.stages.running import Start, starting


@pytest.fixture(scope="session")
def start_script() -> Iterator[Start]:
    """Starts a stage's script in a process of its own, with the arguments of its `main`."""
    with starting() as start:
        yield start
