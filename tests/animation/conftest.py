import pytest

from tests.animation.turning_person import turning_person


@pytest.fixture
def filmed():
    return turning_person()
