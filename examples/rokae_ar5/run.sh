#!/bin/sh
# Rokae AR5: sh examples/rokae_ar5/run.sh DATA, with dynamics_identification_data.csv and AR5-5_07R-W4C4A2.urdf in DATA.
set -e
here=$(cd "$(dirname "$0")" && pwd)
for part in fit held; do
  awk -v part="$part" 'NR == 1 || (NR <= 2001) == (part == "fit")' "$1/dynamics_identification_data.csv" > "$part.csv"
  elastic-arm bag import "$part.csv" --map "$here/import.yaml" --out "run_$part"
done
elastic-arm bag check run_fit || true # exit status 1: something to know
elastic-arm identify run_fit --validate run_held --robot "$1/AR5-5_07R-W4C4A2.urdf" --with coulomb_friction \
  --with viscous_friction --out identified
elastic-arm diagnose run_fit --validate run_held --robot "$1/AR5-5_07R-W4C4A2.urdf" --refit --out diagnosis_refit
