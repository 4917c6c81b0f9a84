"""How many recordings that nothing is wrong with get a warning. ``python -m benchmarks.false_alarms
[BAG…]``.

Drawn ones (`tests/helpers/clean_recordings.py`): rigid arms with dry friction at 100 to 500 Hz in
sines, from point to point, creeping and joint by joint, and servo arms that stand between steps.
Bags that are named, or lie in folders that are, are checked as `bag check` does. A line for each
alarm, then the shares.
"""

import argparse
import time
from collections import Counter
from pathlib import Path

from elastic_arm.recording.inspection.check import check_bag, looked_through
from elastic_arm.recording.inspection.described_gravity import contradicted
from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.inspection.side_motion import Motions
from elastic_arm.recording.recording import Recording
from elastic_arm.robot import Robot
from tests.helpers.clean_recordings import clean_recordings

ALLOWED = 0.01  # share


def alarms(robot: Robot | None, recording: Recording) -> list[Finding]:
    """Return what is worse than a note of a recording.

    Parameters
    ----------
    robot
        The arm, None where it is not known.
    recording
        As read.
    """
    motions = Motions()
    found = looked_through(recording, robot, motions)
    found += [] if robot is None else contradicted(motions, robot)
    return [finding for finding in found if finding.severity != "note"]


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "bags", nargs="*", type=Path, help="bags that are known to be good, or folders of them"
    )
    parser.add_argument("--count", type=int, default=200, help="recordings that are drawn")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    begin = time.perf_counter()
    codes = Counter[str]()
    wrong = 0
    for robot, recording in clean_recordings(given.count, given.seed):
        wrong += _told(recording.source, alarms(robot, recording), codes)
    bags = [
        bag for path in given.bags for bag in sorted({file.parent for file in path.rglob("*.mcap")})
    ]
    for bag in bags:
        wrong += _told(
            str(bag), [one for one in check_bag(bag).findings if one.severity != "note"], codes
        )
    whole = given.count + len(bags)
    lasting = time.perf_counter() - begin
    print(
        f"{wrong} of {whole} clean recordings ({wrong / max(whole, 1):.1%}) get a warning;"
        f" {lasting:.0f} s"
    )
    print(", ".join(f"{code} {count}" for code, count in codes.most_common()))
    raise SystemExit(wrong > ALLOWED * whole)


def _told(source: str, found: list[Finding], codes: Counter[str]) -> bool:
    codes.update({one.code for one in found})
    for one in found:
        print(f"{source}: {one.code}: {one.message}")
    return bool(found)


if __name__ == "__main__":
    main()
