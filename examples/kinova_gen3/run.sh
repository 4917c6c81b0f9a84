#!/bin/sh
# Kinova Gen3: sh examples/kinova_gen3/run.sh DATA, with the two CSV files and the URDF in DATA.
set -e
here=$(cd "$(dirname "$0")" && pwd)
robot="$1/gen3_2f85.urdf"
for k in 1 2; do
  elastic-arm bag import "$1/opti_traj_testing$k.csv" --map "$here/import.yaml" --out run_$k
done
elastic-arm bag check run_1 || true # exit status 1: something to know
friction="--with coulomb_friction:side=link --with viscous_friction:side=link"
elastic-arm identify run_1 --validate run_2 --robot "$robot" $friction --out identified
elastic-arm diagnose run_1 --validate run_2 --robot "$robot" --refit --out diagnosis_refit
