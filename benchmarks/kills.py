"""Kill the recorder at random instants, and see what the bag has lost: at most the chunk that was
being gathered.

python -m benchmarks.kills --kills 100 --seed 1
"""

import argparse
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from sensor_msgs.msg import JointState

from elastic_arm.nodes.support.graph import qos
from elastic_arm.recording import read_recording
from elastic_arm.recording.inspection.check import check_bag
from tests.helpers.bags import holds_samples
from tests.helpers.ros_graph import Graph, ros_graph

LIMIT = 0.5  # seconds that may be lost
RATE = 250.0  # Hz of the arm, so that a busy machine does not fall behind
LONGEST = 3.0  # seconds between the first samples in a bag and the kill


def stamp_of(message: JointState) -> int:
    """Return the stamp of a message, ns."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def lost_by_a_kill(
    graph: Graph, published: list[int], bag: Path, seconds: float
) -> tuple[float, float]:
    """Record, kill, read; return how far the last sample in the bag is behind the kill and behind
    the arm's last, s.

    The arm itself is behind the kill where the machine is busy, and leaves samples out where it is
    very busy: missing is what it has published and the bag does not hold.
    """
    recorder = graph.start("recorder", bag=bag)
    graph.until(lambda: holds_samples(bag), "samples of both sides are in the bag")
    end = time.monotonic() + seconds
    graph.until(lambda: time.monotonic() > end, "the time has come")
    recorder.process.send_signal(signal.SIGKILL)
    killed = time.time_ns()
    newest = published[-1]
    recorder.wait()
    check_bag(bag)
    recording = read_recording(bag)
    last = []
    for side in (recording.link, recording.motor):
        held = set() if side is None else set(side.stamp_ns.tolist())
        if not held or any(
            min(held) < stamp < max(held) and stamp not in held for stamp in published
        ):
            raise RuntimeError(f"{bag}: samples are missing before the last one")
        last.append(max(held))
    return (killed - min(last)) / 1e9, (newest - min(last)) / 1e9


def main() -> int:
    """Kill as often as asked; return 1 if more than the limit was lost once."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.kills", description="Kill the recorder at random instants."
    )
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the instants (0)")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    lost = []
    with tempfile.TemporaryDirectory() as name, ros_graph(Path(name)) as graph:
        published: list[int] = []
        graph.peer.create_subscription(
            JointState,
            "/joint_states",
            lambda message: published.append(stamp_of(message)),
            qos("/joint_states"),
        )
        graph.start("simulator", rate=RATE)
        graph.until(lambda: published, "the arm is there")
        for k in range(options.kills):
            bag = Path(name) / f"bag_{k}"
            lost.append(lost_by_a_kill(graph, published, bag, float(rng.uniform(0.0, LONGEST))))
            shutil.rmtree(bag)
            published[:-1] = []
    print(
        f"{'lost of ' + str(len(lost)) + ' kills, s':32}"
        f"{'median':>9}{'95 %':>9}{'most':>9}{f'above {LIMIT}':>11}"
    )
    for what, seconds in zip(
        ("before the kill", "of what the arm had published"), np.array(lost).T, strict=True
    ):
        quantiles = np.percentile(seconds, [50, 95, 100])
        print(
            f"{what:32}"
            + "".join(f"{value:9.3f}" for value in quantiles)
            + f"{np.sum(seconds > LIMIT):11}"
        )
    return 1 if max(seconds for _, seconds in lost) > LIMIT else 0


if __name__ == "__main__":
    sys.exit(main())
