#!/usr/bin/env bash
# All tests but the nightly ones: `make unit`, or tools/unit.sh with further arguments of pytest.
#
# The tests of the ROS graph keep real time and wait half of it. So they run two at a time, at a higher priority than
# the others, which run beside them, one process a core. Theirs is the second report.
set -uo pipefail
workers=$(nproc) # before OMP_NUM_THREADS is set, which it obeys
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
# The tests start hundreds of processes, each of which would compile the package anew.
unset PYTHONDONTWRITEBYTECODE

report=$(mktemp)
trap 'kill %1 2>/dev/null; rm -f "$report"' EXIT
# Bash lets what runs in the background ignore SIGINT, and nodes would with it.
env --default-signal=INT python -m pytest -n 2 --dist loadscope --no-loadscope-reorder -m "graph and not nightly" \
  "${@:-tests/nodes}" >"$report" 2>&1 &
nice -n 19 python -m pytest -n "$workers" --dist loadscope --no-loadscope-reorder -m "not graph and not nightly" "$@"
others=$?
wait $!
graph=$?
cat "$report"
# 5: no test was chosen, which arguments may make so.
[[ $graph =~ ^[05]$ && $others =~ ^[05]$ && "$graph$others" != 55 ]]
