#!/bin/sh
# KUKA KR300: sh examples/kuka_kr300/run.sh DATA, with run_A.mat to run_C.mat and the two arm files in DATA.
set -e
here=$(cd "$(dirname "$0")" && pwd)
for run in A B C; do
  elastic-arm bag import "$1/run_$run.mat" --map "$here/import_3.yaml" --out "three_axes/run_$run"
  elastic-arm bag import "$1/run_$run.mat" --map "$here/import_6.yaml" --out "six_axes/run_$run"
done
friction="--with coulomb_friction --with viscous_friction"
for axes in three_axes:kr300_3_elastic six_axes:kr300_6_rigid; do
  cd "${axes%%:*}"
  robot="$1/${axes#*:}.yaml"
  elastic-arm bag check run_A || true # exit status 1: something to know
  elastic-arm identify run_A run_C --validate run_B --robot "$robot" $friction --out identified
  elastic-arm diagnose run_A run_C --validate run_B --robot "$robot" --out diagnosis
  elastic-arm diagnose run_A run_C --validate run_B --robot "$robot" $friction --refit --out diagnosis_refit
  cd ..
done
