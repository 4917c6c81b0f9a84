#!/usr/bin/env bash
# Makes the bags of this folder again: the nominal arm on an optimised excitation, and on a random motion to validate on.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
. ../tools/env.sh

rm -rf excitation validation
elastic-arm excite --force --period 8 --ramp 1 --seed 1 --out excitation.yaml
elastic-arm simulate --trajectory excitation.yaml --seed 1 --out excitation
elastic-arm excite --force --period 8 --ramp 1 --seed 2 --evaluations 60 --out validation.yaml
elastic-arm simulate --trajectory validation.yaml --seed 2 --out validation
