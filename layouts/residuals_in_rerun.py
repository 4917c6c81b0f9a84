"""Show a bag of `elastic-arm diagnose --mcap BAG` in rerun (pip install rerun-sdk): the arm beside
its residuals.

    python layouts/residuals_in_rerun.py BAG [FILE.rrd]

With a file it is written for `rerun FILE.rrd`, later or elsewhere.
"""

import sys
from pathlib import Path

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ImportError:
    sys.exit(__doc__)

if len(sys.argv) < 2 or not list(Path(sys.argv[1]).glob("*.mcap")):
    sys.exit(f"{__doc__}\nName the folder of a bag.")
bag, *saved = sys.argv[1:]
rr.init("elastic_arm", spawn=not saved)
shows = {
    side: [f"/residuals/{side}/{when}/effort/**" for when in ("before", "after")]
    for side in ("link", "drive", "motor")
}
curves = [
    rrb.TimeSeriesView(contents=paths, name=f"{side}, Nm: before and after")
    for side, paths in shows.items()
]
shown = rrb.Blueprint(
    rrb.Horizontal(rrb.Spatial3DView(name="arm"), rrb.Vertical(*curves)), collapse_panels=True
)
if saved:
    rr.save(saved[0], default_blueprint=shown)
else:
    rr.send_blueprint(shown)
for file in sorted(Path(bag).glob("*.mcap")):
    rr.log_file_from_path(file)
