"""What the tests of MuJoCo share."""

import pytest


@pytest.fixture(autouse=True)
def _compiled_here(compiled_here: None) -> None:
    """Every test compiles its models in its own process."""
