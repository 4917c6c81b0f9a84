"""The live graph at 1 kHz: samples lost, delay, and what each node costs.

    python benchmarks/bench_live.py [--seconds 60]

First a bare publisher and a bare EventsExecutor subscriber, alone; then simulator, trajectory
generator, identifier and recorder, all at once, with two probes beside them: one of the bare
publisher's messages as bytes, which shows what the load of the graph does to a message's way, and
one of the arm's own samples, whose delay counts from the instant that the stamp names (so it holds
the simulator's step as well).
"""

import argparse
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from array import array
from pathlib import Path

import numpy as np

from elastic_arm.excitation import FourierTrajectory
from elastic_arm.recording import read_recording

JOINTS = ("joint_1", "joint_2", "joint_3")
TICKS = os.sysconf("SC_CLK_TCK")


def publish() -> None:
    """Publish a JointState a millisecond on /probe, stamped as it leaves, until stopped."""
    import rclpy
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = rclpy.create_node("bare_publisher")
    publisher = node.create_publisher(JointState, "/probe", 1000)
    zeros = array("d", bytes(24))
    message = JointState(name=list(JOINTS), position=zeros, velocity=zeros, effort=zeros)
    due = time.monotonic()
    while rclpy.ok():
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        publisher.publish(message)
        due += 1e-3
        time.sleep(max(due - time.monotonic(), 0.0))


def probe(topic: str, seconds: float, raw: bool) -> None:
    """Subscribe to a topic and print delays (µs) and count as JSON, from the first sample on."""
    import rclpy
    from rclpy.experimental import EventsExecutor
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = rclpy.create_node("probe")
    delays: list[int] = []

    def take(message: JointState) -> None:
        now = time.time_ns()
        delays.append(now - message.header.stamp.sec * 10**9 - message.header.stamp.nanosec)

    def take_bytes(data: bytes) -> None:
        now = time.time_ns()
        seconds, rest = struct.unpack_from("<iI", data, 4)
        delays.append(now - seconds * 10**9 - rest)

    node.create_subscription(JointState, topic, take_bytes if raw else take, 1000, raw=raw)
    executor = EventsExecutor()
    executor.add_node(node)
    while not delays:
        executor.spin_once(timeout_sec=0.1)
    delays.clear()
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    p50, p99 = np.percentile(np.array(delays) / 1e3, [50, 99])
    print(json.dumps({"count": len(delays), "p50": p50, "p99": p99}), flush=True)


class Process:
    """A process and the share of a core it takes."""

    def __init__(self, *command: str) -> None:
        self.child = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)

    def cpu(self) -> float:
        """Return the CPU seconds used so far."""
        fields = Path(f"/proc/{self.child.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    def stop(self) -> str:
        """End it as Ctrl-C does, and return what it printed."""
        self.child.send_signal(signal.SIGINT)
        return self.child.communicate(timeout=30)[0]


def node(name: str, **parameters: object) -> Process:
    """Start a node of the suite."""
    options = [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
    return Process("-m", f"elastic_arm.nodes.{name}", "--ros-args", *options)


def bare(seconds: float) -> dict[str, float]:
    """Measure a publisher and a subscriber, alone."""
    publisher = Process(__file__, "--publish")
    subscriber = Process(__file__, "--probe", "/probe", "--seconds", str(seconds))
    told = subscriber.child.communicate(timeout=seconds + 60)[0]
    publisher.child.kill()
    publisher.child.wait()
    return json.loads(told)


def live(folder: Path, seconds: float) -> dict[str, object]:
    """Measure the whole graph."""
    rng = np.random.default_rng(1)
    a = rng.normal(0.0, 0.2, (3, 5))
    b = rng.normal(0.0, 0.2, (3, 5))
    FourierTrajectory(2 * np.pi / 10.0, a, b, np.zeros(3), 10.0, 1.0, JOINTS).save(
        folder / "trajectory.yaml"
    )
    nodes = {
        "identifier": node("identifier", save_to=folder / "online", save_at_exit="true"),
        "recorder": node("recorder", bag=folder / "bag"),
    }
    time.sleep(5.0)  # the listeners first, so that every sample finds them
    nodes["simulator"] = node("simulator")
    nodes["trajectory_generator"] = node(
        "trajectory_generator", trajectory=folder / "trajectory.yaml", repeat=0
    )
    publisher = Process(__file__, "--publish")
    probes = {
        topic: Process(__file__, "--probe", topic, "--seconds", str(seconds), "--raw")
        for topic in ("/probe", "/joint_states")
    }
    time.sleep(5.0)
    began = time.monotonic()
    used = {name: process.cpu() for name, process in nodes.items()}
    told = {
        topic: json.loads(each.child.communicate(timeout=seconds + 60)[0])
        for topic, each in probes.items()
    }
    elapsed = time.monotonic() - began
    shares = {name: (process.cpu() - used[name]) / elapsed for name, process in nodes.items()}
    publisher.child.kill()
    publisher.child.wait()
    for name in ("trajectory_generator", "simulator", "recorder", "identifier"):
        nodes[name].stop()
    recording = read_recording(folder / "bag")
    gaps = {"link": recording.link, "motor": recording.motor}
    lost = {
        name: int(np.sum(np.diff(side.stamp_ns) // 1_000_000 - 1))
        for name, side in gaps.items()
        if side is not None
    }
    online = json.loads((folder / "online" / "identification.json").read_text())
    return {
        "probes": told,
        "shares": shares,
        "lost": lost,
        "recorded": len(recording.samples()),
        "online": online,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--probe", help=argparse.SUPPRESS)
    parser.add_argument("--raw", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.publish:
        return publish()
    if options.probe:
        return probe(options.probe, options.seconds, options.raw)
    load = os.getloadavg()[0]
    alone = bare(min(options.seconds, 20.0))
    with tempfile.TemporaryDirectory() as folder:
        whole = live(Path(folder), options.seconds)
    beside = whole["probes"]["/probe"]
    arm = whole["probes"]["/joint_states"]
    print(f"load before: {load:.1f} on {os.cpu_count()} cores")
    print(f"{'delay':44} p50 µs  p99 µs")
    print(f"{'bare EventsExecutor subscriber, alone':44}{alone['p50']:7.0f} {alone['p99']:7.0f}")
    print(
        f"{'the same messages as bytes, beside the graph':44}{beside['p50']:7.0f}"
        f" {beside['p99']:7.0f}"
    )
    print(f"{'ratio of the medians':44}{beside['p50'] / alone['p50']:7.2f}")
    print(f"{'samples of the arm, from their stamp':44}{arm['p50']:7.0f} {arm['p99']:7.0f}")
    print(f"samples recorded {whole['recorded']}, lost between them {whole['lost']}")
    print(f"samples in the last estimate of the identifier {whole['online']['samples']}")
    for name, share in whole["shares"].items():
        print(f"{name:24} {100 * share:5.1f} % of a core")
    return None


if __name__ == "__main__":
    main()
