#!/usr/bin/env bash
# Makes the pictures of the README again: the heads of two reports, as Chromium shows them.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
. "$here/../../tools/env.sh"
browser=$(command -v chromium || command -v chromium-browser || command -v google-chrome)
runs=$(mktemp -d)
trap 'rm -rf "$runs"' EXIT
cd "$runs"

friction=coulomb_friction:joint_2:torque=13.9
elastic-arm simulate --trajectory "$here/../../bags/excitation.yaml" --effect $friction --seed 1 --out run_1
elastic-arm simulate --trajectory "$here/../../bags/validation.yaml" --effect $friction --seed 2 --out run_2
elastic-arm diagnose run_1 --validate run_2 --out diagnosis
elastic-arm identify run_1 --validate run_2 --with coulomb_friction --out identification

for picture in diagnosis:1010 identification:930; do
  report=${picture%:*}
  "$browser" --headless --no-sandbox --disable-gpu --hide-scrollbars --virtual-time-budget=2000 \
    --user-data-dir=profile --window-size=1240,"${picture#*:}" --screenshot="$here/$report.png" \
    "file://$runs/$report/report.html" 2>/dev/null
done
ls -l "$here"/*.png
