"""Threads of the libraries under NumPy."""

import os
import subprocess
import sys

import pytest

from elastic_arm.blas import one_blas_thread


def test_what_the_user_has_chosen_stays():
    """A number of threads in the environment is not replaced."""
    environment = {"OPENBLAS_NUM_THREADS": "4"}
    one_blas_thread(environment)
    assert environment == {"OPENBLAS_NUM_THREADS": "4", "MKL_NUM_THREADS": "1"}
    chosen = {"OMP_NUM_THREADS": "2"}
    one_blas_thread(chosen)
    assert chosen == {"OMP_NUM_THREADS": "2"}


@pytest.mark.parametrize(
    "code",
    [
        "import elastic_arm.nodes",
        "import elastic_arm.app; sys.argv = ['elastic-arm', '--version']; elastic_arm.app.main()",
    ],
)
def test_the_variable_is_set_before_numpy_reads_it(code):
    """Command line and nodes set the number of threads, and importing them imports no NumPy before
    that."""
    left_out = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name not in left_out}
    package = code.split(";")[0]
    assert "True" not in _output(
        f"import sys; {package}; print('numpy' in sys.modules)", environment
    )
    asked = (
        "import atexit, os, sys; atexit.register(lambda: print('set',"
        " os.environ.get('OPENBLAS_NUM_THREADS')))"
    )
    checked = f"{asked}; {code}"
    assert "set 1" in _output(checked, environment)


def _output(code: str, environment: dict[str, str]) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, check=False, capture_output=True, text=True
    )
    return done.stdout
