"""Threads of the libraries under NumPy."""

from __future__ import annotations

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


@pytest.mark.parametrize("package", ["elastic_arm.app", "elastic_arm.nodes"])
def test_the_variable_is_set_before_numpy_reads_it(package):
    """Neither the command line nor the package of the nodes imports NumPy before the number of threads is set."""
    code = f"import sys, {package}; sys.exit('numpy' in sys.modules)"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 0
