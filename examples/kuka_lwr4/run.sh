#!/bin/sh
# KUKA LWR 4+: sh examples/kuka_lwr4/run.sh DATA, with measurements_1.npz to measurements_3.npz and the URDF in DATA.
set -e
here=$(cd "$(dirname "$0")" && pwd)
robot="$1/kuka_lwr4.urdf"
for k in 1 2 3; do
  elastic-arm bag import "$1/measurements_$k.npz" --map "$here/import.yaml" --out kuka_$k
done
elastic-arm bag check kuka_1 || true # exit status 1: something to know
friction="--with coulomb_friction:side=link --with viscous_friction:side=link"
elastic-arm identify kuka_1 kuka_3 --validate kuka_2 --robot "$robot" $friction --with joint_torque_offset \
  --out identified
elastic-arm diagnose kuka_1 kuka_2 --validate kuka_3 --robot "$robot" --refit --out diagnosis_refit
