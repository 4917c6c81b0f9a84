#!/bin/sh
# Staubli TX40: sh examples/staubli_tx40/run.sh DATA, with pos_read_data.csv, curr_data.csv and tx40.urdf in DATA.
set -e
here=$(cd "$(dirname "$0")" && pwd)
for part in fit held; do
  mkdir -p "arrays_$part"
  for array in pos_read_data curr_data; do
    awk -v part="$part" 'NR == 1 || (NR <= 30001) == (part == "fit")' "$1/$array.csv" > "arrays_$part/$array.csv"
  done
  elastic-arm bag import "arrays_$part" --map "$here/import.yaml" --out "run_$part"
done
elastic-arm bag check run_fit || true # exit status 1: something to know
# Motor 6 turns with axis 5, too.
friction="--with coulomb_friction --with viscous_friction --with wrist_coupling:joint_6"
elastic-arm identify run_fit --validate run_held --robot "$1/tx40.urdf" $friction --out identified
elastic-arm diagnose run_fit --validate run_held --robot "$1/tx40.urdf" $friction --refit --out diagnosis_refit
