"""Memory that is kept for the next array."""

import subprocess
import sys

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose, preparation
from elastic_arm.errors import DiagnosisError
from elastic_arm.memory import available_memory, keep_memory
from tests.helpers.gap_recordings import ROBOT, motions, record


def test_large_arrays_are_made_as_before_where_memory_is_kept():
    """glibc takes the settings, any other library is left alone, and arrays hold what they are
    given."""
    assert isinstance(keep_memory(), bool)
    made = [np.full(1 << 22, float(k)) for k in range(3)]
    del made[1]
    again = np.zeros(1 << 22)
    assert not again.any()
    assert (made[0] == 0.0).all() and (made[1] == 2.0).all()
    assert sys.platform.startswith("linux") or not keep_memory()


def test_what_memory_is_too_small_for_is_refused_with_its_size(monkeypatch):
    """Before anything is taken, and with what to do."""
    assert 1e7 < available_memory() < 1e15 or not sys.platform.startswith("linux")
    monkeypatch.setattr(preparation, "available_memory", lambda: 2e8)
    with pytest.raises(
        DiagnosisError,
        match=r"6 s of 3 joints need about 0\.\d+ GB of memory, but 0\.2 GB are free",
    ):
        diagnose([record(motions()[0])], Question(ROBOT), [record(motions()[1])])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the limit is one of Linux")
def test_a_limit_below_what_the_libraries_take_is_refused_in_a_line():
    """They would wait for ever, or end in a traceback."""
    words = [
        sys.executable,
        "-c",
        "from elastic_arm.app import main; main()",
        "bag",
        "check",
        "run",
    ]
    done = subprocess.run(
        ["sh", "-c", 'ulimit -v 200000; exec "$@"', "sh", *words],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (
        done.returncode == 2
        and done.stderr.count("\n") == 1
        and "MB of memory are free" in done.stderr
    )
