"""The most probable runs among the blocks of a recording, by dynamic programming.

    best_j = max(best_{j-1} + ordinary_{j-1}, max over i < j of best_i + run_ij)

ordinary_j is the log-probability of block j outside all runs, and run_ij that of the blocks i to
j - 1 as one run, including its prior odds.
"""

from collections.abc import Callable

import numpy as np

from elastic_arm.arrays import Array

Runs = list[tuple[int, int]]  # first block, and the block after the last


def most_probable_runs(ordinary: Array, ending: Callable[[int], Array]) -> Runs:
    """Return the most probable runs of blocks, in order.

    ordinary: (M,) nats; ending: j -> run_ij (j,) nats of all runs that end before block j.
    """
    count = len(ordinary)
    best = np.zeros(count + 1)
    came = np.zeros(count + 1, int)
    for j in range(1, count + 1):
        runs = best[:j] + ending(j)
        i = int(np.argmax(runs))
        outside = best[j - 1] + ordinary[j - 1]
        best[j], came[j] = (runs[i], i) if runs[i] > outside else (outside, -1)
    found = []
    j = count
    while j:
        if came[j] >= 0:
            found.append((int(came[j]), j))
        j = int(came[j]) if came[j] >= 0 else j - 1
    return found[::-1]
