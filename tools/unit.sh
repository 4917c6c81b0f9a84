#!/usr/bin/env bash
# All tests: `make unit`, or tools/unit.sh with further arguments of pytest.
#
# The tests of the ROS graph keep real time, so they run by themselves after the others; those run one process a core.
set -uo pipefail
workers=$(nproc) # before OMP_NUM_THREADS is set, which it obeys
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

python -m pytest -n "$workers" --dist loadscope --no-loadscope-reorder -m "not graph" "$@"
others=$?
python -m pytest -m graph "$@"
graph=$?
# 5: no test was chosen, which arguments may make so.
[[ $graph =~ ^[05]$ && $others =~ ^[05]$ && "$graph$others" != 55 ]]
