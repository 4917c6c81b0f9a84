"""Every benchmark can be started: the names it takes from the package are there."""

import importlib
import pkgutil

import pytest

import benchmarks

NAMES = sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__))


@pytest.mark.parametrize("name", NAMES)
def test_it_can_be_imported_and_has_a_main(name: str) -> None:
    """What it imports exists, so that only its figures can be wrong."""
    assert callable(importlib.import_module(f"benchmarks.{name}").main)
