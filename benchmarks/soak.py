"""`make soak`: the live graph for as long as asked, and what it costs and loses on the way.

    python -m benchmarks.soak --minutes 60 --rate 1000 --out runs/soak
    python -m benchmarks.soak --minutes 10 --rate 50 --factor 20    # 3.3 h of the arm

Simulator, trajectory generator, identifier, gap monitor and recorder run at once. Each interval
gives a row of `soak.csv`: memory of each node with its child processes, samples that a subscriber
received, those missing between them, and their delay from the instant that the stamp names, where
the arm runs in real time. `soak.png` shows the course, the table ten parts of it.
"""

import argparse
import csv
import os
import shutil
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from domain_coordinator import domain_id
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from benchmarks.bench_live import JOINTS, node
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.nodes.support.graph import STREAM
from elastic_arm.nodes.support.wire import NANOSECONDS
from elastic_arm.recording import read_recording

INTERVALS = 60  # rows of the file, at most one a second
ROWS = 10  # of the table
WARM_UP = 15.0  # seconds in which the nodes load and find each other
FIGURES = ("samples", "lost", "delay p50, ms", "delay p99, ms", "delay max, ms")


class Probe:
    """A subscriber of the arm's samples and of `/diagnostics`."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("soak")
        self._stamps: list[int] = []
        self._delays: list[int] = []
        self._last = 0
        self.status: dict[str, dict[str, str]] = {}
        self._node.create_subscription(JointState, "/joint_states", self._take, STREAM, raw=True)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 100)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)

    def _take(self, data: bytes) -> None:
        now = time.time_ns()
        sec, nanosec = np.frombuffer(data, np.uint32, 2, 4)
        self._stamps.append(int(sec) * NANOSECONDS + int(nanosec))
        self._delays.append(now - self._stamps[-1])

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.status[status.name] = {value.key: value.value for value in status.values}

    def spin(self, seconds: float) -> None:
        """Take what arrives for some seconds."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, 0.1))

    def figures(self, step_ns: int) -> dict[str, float]:
        """Return what arrived since the last call: samples, those missing between them, delays."""
        stamps = np.array([self._last] * bool(self._last) + self._stamps, dtype=np.int64)
        values: list[float] = [np.nan] * 3
        if self._delays:
            values = [float(v) / 1e6 for v in np.percentile(self._delays, [50, 99, 100])]
        lost = int(np.sum(np.diff(stamps) // step_ns - 1)) if len(stamps) > 1 else 0
        found = dict(zip(FIGURES, (len(self._stamps), lost, *values), strict=True))
        self._last = int(stamps[-1]) if len(stamps) else 0
        self._stamps.clear()
        self._delays.clear()
        return found


def memory(pid: int) -> float:
    """Return the resident memory of a process and its children, MB."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    status = Path(f"/proc/{pid}/status").read_text()
    own = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
    return own / 1e3 + sum(memory(int(child)) for child in children)


def soak(
    folder: Path, minutes: float, rate: float, factor: float = 1.0
) -> tuple[list[dict[str, float]], dict[str, dict[str, str]]]:
    """Run the graph; return a row an interval and the nodes' last figures on `/diagnostics`. Ctrl-C
    ends it early.

    Parameters
    ----------
    folder
        For the bag and the estimate.
    minutes
        How long.
    rate
        Of the arm, Hz.
    factor
        Seconds of the arm a second.
    """
    rng = np.random.default_rng(1)
    a = rng.normal(0.0, 0.2, (3, 5))
    b = rng.normal(0.0, 0.2, (3, 5))
    FourierTrajectory(2 * np.pi / 10.0, a, b, np.zeros(3), 10.0, 1.0, JOINTS).save(
        folder / "trajectory.yaml"
    )
    probe = Probe()
    arm = {
        "rate": rate,
        "real_time_factor": factor,
        "effects": "['coulomb_friction:joint_2:torque=13.9']",
    }
    generated = {"trajectory": folder / "trajectory.yaml", "repeat": 0, "rate": rate}
    clock = {"use_sim_time": "true"} if factor != 1.0 else {}
    due = {"period": max(20.0 / factor, 1.0), "save_period": 3600.0 / factor}
    nodes = {
        "identifier": node("identifier", save_to=folder / "online", **clock),
        "gap_monitor": node("gap_monitor", save_to=folder / "diagnosis", **due, **clock),
        "recorder": node("recorder", bag=folder / "bag", **clock),
        "simulator": node("simulator", **arm),
        "trajectory_generator": node("trajectory_generator", **generated, **clock),
    }
    probe.spin(WARM_UP)
    step_ns = round(NANOSECONDS / rate)
    while not probe.figures(step_ns)["samples"]:
        probe.spin(1.0)
    rows = []
    began = time.monotonic()
    seconds = max(60.0 * minutes / INTERVALS, 1.0)
    with suppress(KeyboardInterrupt):
        while time.monotonic() - began < 60.0 * minutes:
            probe.spin(seconds)
            sizes = {f"{name}, MB": memory(process.child.pid) for name, process in nodes.items()}
            rows.append(
                {"minute": (time.monotonic() - began) / 60.0, **sizes, **probe.figures(step_ns)}
            )
            if clock:
                rows[-1] = {key: value for key, value in rows[-1].items() if key not in FIGURES[2:]}
            done = rows[-1]["minute"]
            lost = sum(row["lost"] for row in rows)
            print(
                f"{done:.1f} of {minutes:g} minutes, {lost:.0f} samples lost",
                file=sys.stderr,
                flush=True,
            )
    for name in ("trajectory_generator", "simulator", "recorder", "identifier", "gap_monitor"):
        nodes[name].stop()
    return rows, probe.status


def gathered(rows: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    """Return at most ten rows: sums of counts, largest delays and sizes, medians of the medians."""
    parts = [
        part for part in np.array_split(np.arange(len(rows)), min(ROWS, len(rows))) if len(part)
    ]
    how = {"minute": np.max, "samples": np.sum, "lost": np.sum, "delay p50, ms": np.median}
    return [
        {key: float(how.get(key, np.max)([rows[k][key] for k in part])) for key in rows[0]}
        for part in parts
    ]


def table(rows: Sequence[dict[str, float]]) -> str:
    """Return rows as a table for a page."""
    lines = ["| " + " | ".join(rows[0]) + " |", "|" + "---|" * len(rows[0])]
    digits = {"minute": 1, "delay p50, ms": 1, "delay p99, ms": 1, "delay max, ms": 1}
    lines += [
        "| " + " | ".join(f"{value:.{digits.get(key, 0)}f}" for key, value in row.items()) + " |"
        for row in rows
    ]
    return "\n".join(lines)


def draw(rows: Sequence[dict[str, float]], file: Path) -> None:
    """Draw memory, losses and delays over time."""
    minutes = [row["minute"] for row in rows]
    figure, (above, middle, below) = plt.subplots(
        3, 1, sharex=True, figsize=(8, 7), layout="constrained"
    )
    for key in rows[0]:
        if key.endswith(", MB"):
            above.plot(minutes, [row[key] for row in rows], label=key.removesuffix(", MB"))
    above.set(ylabel="resident memory, MB", ylim=(0, None))
    above.legend(ncols=3, loc="lower right", fontsize="small")
    middle.step(minutes, [row["lost"] for row in rows], where="mid", color="C3")
    middle.set(
        ylabel="samples lost\nin the interval", ylim=(0, max(1.0, *(row["lost"] for row in rows)))
    )
    for key in FIGURES[2:] if FIGURES[2] in rows[0] else ():
        below.plot(
            minutes, [row[key] for row in rows], label=key.split(",")[0].removeprefix("delay ")
        )
    below.set(xlabel="minutes", ylabel="delay, ms", yscale="log")
    below.legend(ncols=3, fontsize="small")
    figure.savefig(file, dpi=110)


def main() -> int:
    """Run, write, print; return 1 if a sample was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the arm, Hz (1000)")
    parser.add_argument("--factor", type=float, default=1.0, help="seconds of the arm a second (1)")
    parser.add_argument("--out", type=Path, default=Path("runs/soak"))
    options = parser.parse_args()
    shutil.rmtree(options.out, ignore_errors=True)
    options.out.mkdir(parents=True)
    before = os.getloadavg()[0]
    with domain_id() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        rows, status = soak(options.out, options.minutes, options.rate, options.factor)
    if not rows:
        print("ended before the first interval", file=sys.stderr)
        return 130
    with (options.out / "soak.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    draw(rows, options.out / "soak.png")
    print(table(gathered(rows)))
    recorded = read_recording(options.out / "bag")
    assert recorded.motor is not None
    missing = int(np.sum(np.diff(recorded.motor.stamp_ns) // round(NANOSECONDS / options.rate) - 1))
    print(
        f"load before {before:.1f} on {os.cpu_count()} cores; {len(recorded.motor)} recorded,"
        f" {missing} missing"
    )
    for name in sorted(status):
        shown = {
            key: value for key, value in status[name].items() if "sample" in key or "diagnos" in key
        }
        if shown:
            print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in shown.items()))
    return 1 if missing or sum(row["lost"] for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
