#!/bin/sh
# UR10e: sh examples/ur10e/run.sh DATA, with ur10e.urdf and the recordings of 30, 40 and 50 s, 12 harmonics, in DATA.
set -e
here=$(cd "$(dirname "$0")" && pwd)
robot="$1/ur10e.urdf"
for run in 10-30 12-40 12-50; do
  elastic-arm bag import "$1/ur-20_02_${run}sec_12harm.csv" --map "$here/import.yaml" --out "run_${run#*-}"
done
elastic-arm bag check run_50 || true # exit status 1: something to know
friction="--with coulomb_friction --with viscous_friction"
elastic-arm identify run_50 run_30 --validate run_40 --robot "$robot" $friction --out identified
elastic-arm diagnose run_50 run_30 --validate run_40 --robot "$robot" --refit --out diagnosis_refit
