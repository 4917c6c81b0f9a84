"""What tests of the studies share."""

import multiprocessing
import time
from collections.abc import Iterator
from multiprocessing.process import BaseProcess

import pytest


@pytest.fixture
def bystander() -> Iterator[BaseProcess]:
    """A process of the test's own, beside those of the library."""
    process = multiprocessing.get_context("spawn").Process(
        target=time.sleep, args=(120.0,), daemon=True
    )
    process.start()
    yield process
    process.terminate()
    process.join()
