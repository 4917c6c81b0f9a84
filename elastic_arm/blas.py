"""The number of threads of the libraries under NumPy and SciPy."""

from collections.abc import MutableMapping

_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_blas_thread(environment: MutableMapping[str, str]) -> None:
    """Have BLAS take one thread, unless the user has chosen: before NumPy is imported.

    Its threads wait for each other by spinning, thousands of times in a diagnosis. Beside other
    work, two on two cores take three times as long as one; on a quiet machine they gain nothing.
    The project's own kernels share samples out among the cores as before
    (:mod:`elastic_arm.codegen.parallel`).
    """
    # which these libraries go by where their own variable is not there
    if "OMP_NUM_THREADS" in environment:
        return
    for name in _VARIABLES:
        environment.setdefault(name, "1")
