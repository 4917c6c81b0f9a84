"""The whole suite at work in a live ROS 2 graph, from excitation to estimate and diagnosis: `make
demo`.

The simulated arm differs from its description by up to 15 % in every inertial and elastic number,
so that there is something to find. Its true numbers are read only by the comparison at the end.
"""

import argparse
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.markup import escape
from rich.rule import Rule
from scipy.stats import chi2

from elastic_arm.cli.console import err, out, print_error
from elastic_arm.cli.describe import base_of
from elastic_arm.cli.diagnose import draw_report, save_diagnosis
from elastic_arm.cli.diagnosis_printing import print_diagnosis, print_written
from elastic_arm.diagnosis import Question, diagnose, follow_up
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.diagnosis.words import instance_text
from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.errors import ElasticArmError, GraphError, OutputError, require_ros
from elastic_arm.excitation import (
    ExcitationResult,
    FourierTrajectory,
    MotionLimits,
    Shape,
    Workspace,
    optimise,
    random_trajectories,
)
from elastic_arm.identification import Identification, identify
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.robot import Robot, load_robot, save_robot
from elastic_arm.simulation import SimulationSettings, simulate
from examples.known_arm import chi_square, true_values, varied

EVALUATIONS = 600
SHAPE = Shape(harmonics=5, period=8.0, periods=2)
START = 120.0  # s that nodes may take to find each other, and the first kernels to compile
PATIENCE, ABANDONED = (
    30.0,
    5.0,
)  # s that nodes may take to end; and where the user does not wait for them
# Effects of which one is drawn, of a size that is clearly seen on an industrial arm.
EFFECTS = (
    "coulomb_friction:{}:torque=13", "viscous_friction:{}:coefficient=20",
    "hysteresis:{}:torque=12,width=0.0005", "stiffness_mismatch:{}:stiffness=0.5",
    "joint_torque_offset:{}:offset=5", "joint_zero:{}:offset=0.05",
    "transmission_error:{}:amplitude=5e-5,phase=1", "joint_spring:{}:stiffness=120",
)  # fmt: skip


def main() -> None:
    """Run the demo."""
    parser = argparse.ArgumentParser(
        description="Move an arm in a live ROS 2 graph, record, identify, diagnose."
    )
    parser.add_argument(
        "--out", type=Path, default=Path("runs/demo"), help="folder of all that the demo writes"
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="of the arm, the search and the noise (1)"
    )
    parser.add_argument(
        "--speed", type=float, default=1.0, help="times real time; above 1 the graph runs on /clock"
    )
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # nodes are ended as by Ctrl-C
    try:
        demo(options.out, options.seed, options.speed)
    except ElasticArmError as error:
        print_error(error)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None


def demo(folder: Path, seed: int, speed: float) -> None:
    """Excite, run the graph, identify, compare, and diagnose another arm."""
    require_ros("the demo shows a live graph, which needs")
    _make_room(folder)
    nominal = load_robot(None)
    true_arm = varied(nominal, np.random.default_rng(seed))
    save_robot(true_arm, folder / "true_arm.yaml")
    _heading("1  a motion that excites the parameters")
    search = _excite(nominal, seed)
    search.trajectory.save(folder / "trajectory.yaml")
    _heading("2  the live graph: simulator, trajectory generator, identifier, recorder")
    online = _live(folder, search.trajectory, seed, speed)
    _heading("3  the same arm, identified from the bag")
    offline = identify(read_recording(folder / "bag"), nominal)
    out.print(f"{offline.samples} samples, derivatives by {', '.join(offline.derivatives)}")
    _heading("4  estimates and the truth")
    _compare(offline, online, true_values(offline, true_arm))
    report = _report(folder / "report.html", offline)
    _heading("5  another arm has an effect that the diagnosis is not told")
    _diagnose_withheld(folder / "withheld", nominal, search.trajectory, np.random.default_rng(seed))
    out.print(f"\nbag:     {escape(str(folder / 'bag'))}   (ros2 bag info, Foxglove, PlotJuggler)")
    out.print(f"report:  {escape(str(report))}")


def _heading(title: str) -> None:
    out.print(Rule(escape(title)), width=80)


def _make_room(folder: Path) -> None:
    """Clear what an earlier demo left in its folder, and nothing else."""
    left = [
        folder / name for name in ("bag", "nodes", "online", "withheld") if (folder / name).is_dir()
    ]
    if left and not (folder / "true_arm.yaml").is_file():
        raise OutputError(f"{left[0]} exists and is no demo's", "Choose another folder with --out.")
    for path in left:
        shutil.rmtree(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{folder} cannot be made: {error.strerror}", "Choose another folder with --out."
        ) from error


def _excite(nominal: Robot, seed: int) -> ExcitationResult:
    model = build_model(nominal, "mod3")
    limits = MotionLimits.of(nominal, workspace=Workspace.of(nominal))
    with err.status("pattern search") as status:
        found = optimise(
            model,
            limits,
            base_of(model).columns,
            rng=np.random.default_rng(seed),
            shape=SHAPE,
            evaluations=EVALUATIONS,
            progress=lambda k, best: status.update(
                f"pattern search, {k}/{EVALUATIONS}: condition number {best:.2f}"
            ),
        )
    out.print(
        f"condition number of the base regressor: {found.condition_after:.2f}; random motions"
        f" within the same limits: {np.median(found.random):.2f} (median)"
    )
    return found


def _live(folder: Path, motion: FourierTrajectory, seed: int, speed: float) -> dict[str, Any]:
    """Run the graph until the trajectory has been streamed; return the last estimate of the
    identifier."""
    domain = int(os.environ.get("ROS_DOMAIN_ID", 1 + os.getpid() % 100))
    last: dict[str, Any] = {}
    with started(Nodes(folder / "nodes", domain)) as nodes:
        nodes.start("recorder", bag=str(folder / "bag"))
        nodes.start("identifier", print=True, save_at_exit=True, save_to=str(folder / "online"))
        arm = {"robot": str(folder / "true_arm.yaml"), "initial_position": motion.q0.tolist()}
        nodes.start("simulator", **arm, seed=seed, real_time_factor=speed)
        nodes.start(
            "trajectory_generator",
            trajectory=str(folder / "trajectory.yaml"),
            use_sim_time=speed != 1.0,
        )
        out.print(
            f"{'samples':>8}{'residual RMS':>15}{'condition':>12}{'std of the worst parameter':>29}"
        )
        end = time.monotonic() + motion.duration / speed + START
        while nodes.running("trajectory_generator"):
            for last in nodes.told(0.5):
                _show(last)
            if not last and time.monotonic() > end:
                raise GraphError(
                    "no estimate arrived", f"The nodes' messages are in {folder / 'nodes'}."
                )
        for name in ("simulator", "identifier", "recorder"):
            nodes.stop(name)
        for last in nodes.told(0.5):
            _show(last)
    if not last:
        raise GraphError(
            "the identifier made no estimate", f"Its output is in {nodes.log('identifier')}."
        )
    return last


def _show(line: dict[str, Any]) -> None:
    value, std = (np.abs(np.array(line[key], dtype=float)) for key in ("value", "std"))
    worst = float(np.nanmax(std / np.maximum(value, 1e-12))) if len(value) else float("nan")
    number = line["condition_number"] or np.inf
    out.print(
        f"{line['samples']:>8}{line['residual_rms']:>12.4f} Nm{number:>12.4g}{100 * worst:>27.3g} %"
    )


class Nodes:
    """Nodes of the suite as child processes, with parameter files and logs in a folder, on a domain
    of their own."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        self.environment = {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
        }
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self.lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        folder.mkdir(parents=True, exist_ok=True)

    def start(self, name: str, **parameters: Any) -> None:
        """Start a node; what it prints arrives in `lines`."""
        file = self.folder / f"{name}.yaml"
        file.write_text(yaml.safe_dump({name: {"ros__parameters": parameters}}), encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            f"elastic_arm.nodes.{name}",
            "--ros-args",
            "--params-file",
            str(file),
        ]
        with self.log(name).open("w", encoding="utf-8") as log:
            process = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=self.environment,
                start_new_session=True,
            )
        self.processes[name] = process
        assert process.stdout is not None
        threading.Thread(
            target=lambda: [self.lines.put(line) for line in process.stdout or ()], daemon=True
        ).start()

    def log(self, name: str) -> Path:
        """Return the file of a node's stderr."""
        return self.folder / f"{name}.log"

    def running(self, name: str) -> bool:
        """Return whether a node still runs; a GraphError if any died of an error."""
        for other, process in self.processes.items():
            self._check(other, process.poll() or 0)
        return self.processes[name].poll() is None

    def stop(self, name: str) -> None:
        """Interrupt a node, and wait until it has ended; a GraphError if that is by an error."""
        self.processes[name].send_signal(signal.SIGINT)
        self._check(name, ended(self.processes.pop(name), PATIENCE))

    def told(self, seconds: float) -> Iterator[dict[str, Any]]:
        """Yield what arrives within `seconds`."""
        wait = seconds
        while True:
            try:
                yield json.loads(self.lines.get(timeout=wait))
            except queue.Empty:
                return
            wait = 1e-3

    def _check(self, name: str, code: int) -> None:
        if code:
            words = self.log(name).read_text(encoding="utf-8").strip().splitlines() or [
                "error: it said nothing"
            ]
            last = words[-1].removeprefix("error: ")
            raise GraphError(
                f"node {name} ended with code {code}: {last}", f"All of it is in {self.log(name)}."
            )


@contextmanager
def started(nodes: Nodes) -> Iterator[Nodes]:
    """Yield nodes, and end all that run at the end; not much is waited for after an error or an
    interrupt."""
    patience = ABANDONED
    try:
        yield nodes
        patience = PATIENCE
    finally:
        for process in nodes.processes.values():
            process.send_signal(signal.SIGINT)
        end = time.monotonic() + patience
        for process in nodes.processes.values():
            ended(process, max(end - time.monotonic(), 0.1))


def ended(process: subprocess.Popen[str], patience: float) -> int:
    """Wait for a process, kill it if it takes too long, and return its status."""
    try:
        return process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def _compare(offline: Identification, live: dict[str, Any], truth: np.ndarray) -> None:
    online = dict(zip(live["name"], zip(live["value"], live["std"], strict=True), strict=True))
    values, stds = (
        np.array([online[e.name][k] for e in offline.estimates], dtype=float) for k in (0, 1)
    )
    on, off = (values - truth) / stds, (offline.Psi_base - truth) / offline.std
    out.print("errors in standard deviations")
    out.print(
        f"{'nominal':>10}{'true':>11}{'online':>11}{'error':>7}{'offline':>11}{'error':>7}  base"
        " parameter"
    )
    for k, e in enumerate(offline.estimates):
        live_value = f"{values[k]:11.4g}{on[k]:+7.1f}"
        batch_value = f"{e.value:11.4g}{off[k]:+7.1f}"
        out.print(f"{e.nominal:10.4g}{truth[k]:11.4g}{live_value}{batch_value}  {escape(e.short)}")
    out.print(
        f"true value within two standard deviations: online {int((np.abs(on) < 2).sum())}, "
        f"offline {int((np.abs(off) < 2).sum())} of {len(truth)} base parameters"
    )
    out.print(
        "one torque scale is common to all, so that their errors go together: chi² with"
        f" correlations {chi_square(offline, truth):.0f}, 95 % of fits stay below"
        f" {chi2.ppf(0.95, len(truth)):.0f}"
    )
    apart = np.abs(values - offline.Psi_base) / np.hypot(stds, offline.std)
    out.print(f"online and offline apart: at most {apart.max():.2f} standard deviations")


def _report(path: Path, offline: Identification) -> Path:
    """Write the report of the identification."""
    # Matplotlib is slow to import, and only this needs it.
    from elastic_arm.report.html import write_report
    from elastic_arm.report.identification import sections

    return write_report(
        path, "The live arm", sections(offline), subtitle=f"{offline.robot}, {offline.model}"
    )


def _diagnose_withheld(
    folder: Path, nominal: Robot, motion: FourierTrajectory, rng: np.random.Generator
) -> None:
    """Record an arm with a drawn effect on two motions, diagnose the bags, and print what was drawn
    afterwards."""
    drawn = parse(str(rng.choice(EFFECTS)).format(rng.choice(nominal.joint_names)), nominal)
    other = random_trajectories(build_model(nominal), MotionLimits.of(nominal), 1, rng=rng)[0]
    with err.status("recording the arm on two motions"):
        for name, trajectory in (("identify", motion), ("validate", other)):
            write_recording(
                folder / name,
                simulate(nominal, trajectory, SimulationSettings(effects=[drawn]), rng=rng),
            )
    with err.status("diagnosing"):
        fitted, judged = (read_recording(folder / name) for name in ("identify", "validate"))
        found = follow_up(diagnose([fitted], Question(nominal), [judged]), rng=rng)
        save_diagnosis(found, repaired_robot(nominal, found) if found.causes else None, folder)
        draw_report(found, folder)
    print_diagnosis(found)
    print_written(folder)
    words = f"{drawn.effect.id} on {drawn.joint}, {instance_text(drawn, nominal.units)}"
    out.print(f"what had been drawn: {escape(words)}")


if __name__ == "__main__":
    main()
