"""How long a reader that was held up waits for what it has missed. ``python -m
benchmarks.bench_held_up``.

A subscriber is stopped (SIGSTOP) for longer than Fast DDS's shared memory lasts, and continued.
Counted is the longest time without a message in the three seconds after: with the suite's profile,
and with Fast DDS's own settings.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from elastic_arm.nodes.transport import PROFILE_VARIABLE

RATE = 500.0  # Hz of the arm
HELD = 2.5  # s
AFTER = 3.0  # s
SPACE = "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"
OWN = f'<profiles xmlns="{SPACE}"><participant profile_name="own"/></profiles>'


def listen(path: Path) -> None:
    """Write the time at which each message arrives, until the process is ended."""
    import rclpy
    from rclpy.experimental import EventsExecutor
    from sensor_msgs.msg import JointState

    from elastic_arm.nodes.support import graph
    from elastic_arm.recording import topics

    rclpy.init()
    node = rclpy.create_node("held_up")
    executor = EventsExecutor()
    executor.add_node(node)
    with path.open("w", buffering=1) as file:
        for topic in (topics.JOINT_STATES, topics.MOTOR_STATES):
            node.create_subscription(
                JointState,
                topic,
                lambda _: print(time.monotonic(), file=file),
                graph.qos(topic),
                raw=True,
            )
        while True:
            executor.spin_once(timeout_sec=0.1)


def pauses(env: dict[str, str], times: int, folder: Path) -> np.ndarray:
    """Return the longest time without a message after each of so many stops (times,), s."""
    arrivals = folder / "arrivals"
    continued = []
    command = [
        sys.executable,
        "-m",
        "elastic_arm.nodes.simulator",
        "--ros-args",
        "-p",
        f"rate:={RATE}",
    ]
    simulator = subprocess.Popen(
        command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    reader = subprocess.Popen(
        [sys.executable, "-m", __spec__.name, "--listen", str(arrivals)], env=env
    )
    try:
        while not (arrivals.exists() and arrivals.stat().st_size > 1e5):
            time.sleep(0.1)
        for _ in range(times):
            reader.send_signal(signal.SIGSTOP)
            time.sleep(HELD)
            continued.append(time.monotonic())
            reader.send_signal(signal.SIGCONT)
            time.sleep(AFTER)
    finally:
        for process in (reader, simulator):
            process.kill()
            process.wait()
    at = np.array([float(line) for line in arrivals.read_text().splitlines()[:-1]])
    spans = [np.concatenate([[t], at[(at > t) & (at < t + AFTER)], [t + AFTER]]) for t in continued]
    return np.array([np.diff(span).max() for span in spans])


def main() -> None:
    """Measure both settings in turn and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=30, help="stops of each setting")
    parser.add_argument("--listen", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.listen:
        listen(options.listen)
    with tempfile.TemporaryDirectory() as name:
        own = Path(name) / "own.xml"
        own.write_text(OWN)
        for kind, setting in (
            ("the suite's profile", {}),
            ("Fast DDS's own", {PROFILE_VARIABLE: str(own)}),
        ):
            found = pauses(
                {**os.environ, "ROS_DOMAIN_ID": "77", **setting}, options.times, Path(name)
            )
            print(
                f"{kind:20} longest pause after {len(found)} stops of {HELD} s: median"
                f" {np.median(found):.2f}, 90 % {np.percentile(found, 90):.2f}, most"
                f" {found.max():.2f} s",
                flush=True,
            )
            (Path(name) / "arrivals").unlink()


if __name__ == "__main__":
    main()
