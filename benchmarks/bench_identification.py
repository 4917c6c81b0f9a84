"""Identification against its peers: ratios measured in one run. ``python -m
benchmarks.bench_identification``.

Two jobs. *From arrays*: the triangular factors of the equations and their solution, Phi never
stored, against building Phi with the same compiled kernel and numpy's lstsq, errors of both against
a known truth. Ours has one thread of BLAS, as commands have; the peer has as many as make it
fastest in that round, one or all. *From a bag*: a recording on disk to parameters with standard
deviations, against rosbags' reading and deserialising, a loop over Pinocchio's regressor, and
numpy's lstsq. The peers' costs are linear: they are timed on fewer samples and scaled up. Wall
times; in brackets processor time, which a busy machine disturbs less; ours and the peer take turns.
Last, how the cost grows with N and n.
"""

import argparse
import ctypes
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from benchmarks.bench_regressor import PinocchioLoop
from elastic_arm.codegen.parallel import threads
from elastic_arm.dynamics import Model, build_model
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification import IdentificationSettings, identify
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Blocks, fit
from elastic_arm.identification.triangular import AT_ONCE, triangular
from elastic_arm.memory import keep_memory
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.robot import load_robot
from tests.helpers.periodic_arm import record
from tests.helpers.random_arms import random_arm

REPEATS = 5
PEER_REPEATS = 3
PEER_SAMPLES = 50_000
LOOP_SAMPLES = 2_000


def timed(work: Callable[[], object], repeats: int = REPEATS) -> tuple[float, float]:
    """Median wall and processor seconds of calls after the first; of that one where there are no
    `repeats`."""
    times = [seconds_of(work)]
    times = [seconds_of(work) for _ in range(repeats)] or times
    wall, cpu = np.median(times, axis=0)
    return float(wall), float(cpu)


def seconds_of(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor seconds of one call."""
    begin = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begin[0], time.process_time() - begin[1]


def set_blas_threads(count: int) -> bool:
    """Have NumPy's BLAS take so many threads, whether or not that could be set."""
    maps = Path("/proc/self/maps")
    lines = maps.read_text(encoding="utf-8").splitlines() if maps.exists() else []
    for library in {line.split()[-1] for line in lines if "openblas" in line}:
        for name in ("scipy_openblas_set_num_threads64_", "openblas_set_num_threads"):
            if setter := getattr(ctypes.CDLL(library), name, None):
                setter(ctypes.c_int(count))
                return True
    return False


def best_of_blas(work: Callable[[], object]) -> tuple[float, float, int]:
    """Wall and processor seconds of the call with one or all threads of BLAS that ends first, and
    their number."""
    found = []
    for count in sorted({1, threads()}):
        if set_blas_threads(count) or not found:
            found.append((*timed(work, 0), count))
    set_blas_threads(1)
    return min(found)


def random_motion(model: Model, count: int, rng: np.random.Generator) -> Motion:
    """Random states, and the torques of the model to rounding."""
    n = model.n
    q, dq, ddq, deflection, dtheta, ddtheta = rng.standard_normal((6, count, n))
    theta = q + 1e-3 * deflection
    x = np.hstack([q, theta])
    dx = np.hstack([dq, dtheta])
    ddx = np.hstack([ddq, ddtheta])
    tau = model.inverse_dynamics(x, dx, ddx)
    return Motion(np.arange(count) * 1e-3, q, dq, ddq, theta, dtheta, ddtheta, tau_m=tau)


class FromArrays:
    """Both ways from states and left sides to base parameters; every row of (1) has its own left
    side."""

    def __init__(self, model: Model, count: int) -> None:
        self.model = model
        self.columns = BaseRegression(model, ("q", "theta", "tau_m")).base.columns
        self.true = BaseRegression(model, ("q", "theta", "tau_m")).base.T @ model.Psi
        motion = random_motion(model, count, np.random.default_rng(0))
        self.states = [
            np.hstack([getattr(motion, rate + "q"), getattr(motion, rate + "theta")])
            for rate in ("", "d", "dd")
        ]
        self.y = motion.tau_m

    def fused(self) -> np.ndarray:
        """Bring one part of Phi after another to triangular form, as `identify` does, and solve."""
        factors = np.zeros((self.model.dof, 0, len(self.columns) + 1))
        for start in range(0, len(self.y), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            some = [values[part] for values in self.states]
            Phi = self.model.regressor(*some, columns=self.columns)
            rows = np.concatenate([Phi, self.y[part][..., None]], axis=2).transpose(1, 0, 2)
            factors = triangular(np.concatenate([factors, rows], axis=1))
        blocks = Blocks(self.model.dof, len(self.columns) + 1)
        blocks.add(factors, len(self.y))
        return fit(blocks, power=0.0).Psi

    def stored(self) -> np.ndarray:
        """Build Phi and call lstsq."""
        Phi = self.model.regressor(*self.states, columns=self.columns)
        return np.linalg.lstsq(Phi.reshape(-1, len(self.columns)), self.y.reshape(-1), rcond=None)[
            0
        ]

    def error(self, Psi: np.ndarray) -> float:
        """Largest relative error."""
        return float(np.max(np.abs(Psi / self.true - 1.0)))


def recording(model: Model, count: int) -> Recording:
    """A recording of periodic motion with noise, `count` samples at 1 kHz."""
    s = record(
        model,
        np.random.default_rng(1),
        periods=max(count // 10_000, 1),
        encoder_noise=1e-6,
        velocity_noise=1e-4,
    )
    link = Side(s.stamp_ns, s.q, s.dq, s.tau_J)
    motor = Side(s.stamp_ns, s.theta, s.dtheta, s.tau_m)
    return Recording(model.robot.joint_names, link=link, motor=motor, source="benchmark")


def from_bag(model: Model, bag: Path) -> None:
    """Read a bag and identify, standard deviations included."""
    identify(read_recording(bag), model.robot, IdentificationSettings(consistent=False))


def read_by_rosbags(bag: Path) -> None:
    """Read and deserialise all messages into arrays."""
    rows = []
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if hasattr(message, "effort"):
                rows.append((message.position, message.velocity, message.effort))
    np.array(rows)


def report_arrays(model: Model, count: int) -> None:
    """Print the first job."""
    job = FromArrays(model, count)
    rounds = [(timed(job.fused, 3), best_of_blas(job.stored)) for _ in range(PEER_REPEATS)]
    ours = np.median([own for own, _ in rounds], axis=0)
    theirs = np.median([peer for _, peer in rounds], axis=0)
    ratio = np.median([[peer[k] / own[k] for k in range(2)] for own, peer in rounds], axis=0)
    errors = job.error(job.fused()), job.error(job.stored())
    print(
        f"from arrays, {count} samples, {len(job.columns)} base parameters, {model.dof} rows a"
        " sample"
    )
    print(
        f"  Phi not stored       {ours[0]:9.4f} s ({ours[1]:.4f})   largest relative error"
        f" {errors[0]:.1e}"
    )
    print(
        f"  build Phi and lstsq  {theirs[0]:9.4f} s ({theirs[1]:.4f})   largest relative error"
        f" {errors[1]:.1e}"
    )
    print(
        f"  threads of BLAS      ours 1, the peer's in each round {[peer[2] for _, peer in rounds]}"
    )
    print(f"  ratio {ratio[0]:.0f} ({ratio[1]:.0f}), error ratio {errors[0] / errors[1]:.2g}")


def report_bag(model: Model, count: int, folder: Path) -> None:
    """Print the second job."""
    keep_memory()  # as `elastic-arm identify` does
    bags = {}
    for name, size in (("whole", count), ("peer", PEER_SAMPLES)):
        bags[name] = folder / name
        write_recording(bags[name], recording(model, size))
    ours = timed(lambda: from_bag(model, bags["whole"]), 3)
    job = FromArrays(model, PEER_SAMPLES)
    loop = PinocchioLoop(model.robot, bearings=False, columns=len(job.columns))
    few = [a[:LOOP_SAMPLES] for a in job.states]
    parts = {
        "rosbags, read and deserialise": (
            timed(lambda: read_by_rosbags(bags["peer"]), 1),
            count / PEER_SAMPLES,
        ),
        "Pinocchio regressor, loop": (timed(lambda: loop(*few), 3), count / LOOP_SAMPLES),
        "numpy lstsq": (best_of_blas(job.stored)[:2], count / PEER_SAMPLES),
    }
    total = np.zeros(2)
    print(f"from a bag, {count} samples (two topics)")
    print(f"  ours, bag to parameters with standard deviations {ours[0]:8.2f} s ({ours[1]:.2f})")
    for name, (seconds, scale) in parts.items():
        print(
            f"  {name:48s} {seconds[0] * scale:8.2f} s ({seconds[1] * scale:.2f}), scaled up by"
            f" {scale:.0f}"
        )
        total += np.array(seconds) * scale
    print(f"  ratio {total[0] / ours[0]:.0f} ({total[1] / ours[1]:.0f})")


def report_growth(model: Model) -> None:
    """Print how the cost of the sums grows with N and n."""
    print("growth: microseconds a sample of the sums and the solution, from arrays")
    for count in (10_000, 100_000, 1_000_000):
        print(
            f"  n = 3, N = {count:8d}:"
            f" {1e6 * timed(FromArrays(model, count).fused, 3)[0] / count:8.3f}"
        )
    for n in (3, 6, 7, 12):
        arm = build_model(random_arm(n, np.random.default_rng(n)))
        job = FromArrays(arm, 50_000)
        print(
            f"  n = {n}, {len(job.columns):3d} parameters:"
            f" {1e6 * timed(job.fused, 3)[0] / 50_000:8.3f}"
        )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000, help="of the recording on disk")
    parser.add_argument("--array-samples", type=int, nargs="*", default=[200_000, 1_000_000])
    arguments = parser.parse_args()
    model = build_model(load_robot(None), "mod3")
    set_blas_threads(1)
    for count in arguments.array_samples:
        report_arrays(model, count)
    with tempfile.TemporaryDirectory() as folder:
        report_bag(model, arguments.samples, Path(folder))
    report_growth(model)


if __name__ == "__main__":
    main()
