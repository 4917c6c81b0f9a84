"""What the tests of MuJoCo share."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _compiled_here(compiled_here: None) -> None:
    """Every module compiles its models in the process of the tests."""
