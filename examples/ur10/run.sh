#!/bin/sh
# UR10: sh examples/ur10/run.sh DATA, with ur10_exciting_trajectory.db3 and validation_trajectory.db3 in DATA.
set -e
for bag in ur10_exciting_trajectory validation_trajectory; do
  elastic-arm bag info "$1/$bag.db3"
  elastic-arm bag check "$1/$bag.db3" || true # exit status 1: something to know
done
