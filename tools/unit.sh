#!/usr/bin/env bash
# All tests, those of the ROS graph beside the others: `make unit`, or tools/unit.sh with further arguments of pytest.
#
# The graph keeps real time and waits for most of it. So it comes first wherever it wants a core, and the others, one
# process a core at a low priority, take what it leaves; what they print comes when both are done.
set -uo pipefail
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
log=$(mktemp)
# Without a terminal of its own a job in the background ignores Ctrl-C.
trap 'kill "$others" 2>/dev/null; rm -f "$log"' EXIT
trap 'exit 130' INT TERM

nice -n 10 python -m pytest -n "$(nproc)" --dist loadscope --no-loadscope-reorder -m "not graph" "$@" >"$log" 2>&1 &
others=$!
python -m pytest -m graph "$@"
graph=$?
wait "$others"
rest=$?
cat "$log"
# 5: no test was chosen, which arguments may make so.
[[ $graph =~ ^[05]$ && $rest =~ ^[05]$ && "$graph$rest" != 55 ]]
