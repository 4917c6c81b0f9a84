"""What a worker process of a test answers; a module of its own, as the process imports all of it at
each start."""

import os
from collections.abc import Callable
from typing import Any

from elastic_arm.errors import DiagnosisError


def halving(least: int) -> Callable[[int], Any]:
    """Return what halves numbers, refuses small ones, and dies of zero."""

    def halve(number: int) -> tuple[int, float]:
        if number == 0:
            os._exit(3)
        if number < least:
            raise DiagnosisError(f"{number} is too small", "Take more")
        return os.getpid(), number / 2

    return halve
