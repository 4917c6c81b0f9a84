"""Regressor over arrays of samples: ratios against peers, in one run. ``python -m
benchmarks.bench_regressor``.

Peers: Pinocchio's ``computeJointTorqueRegressor`` on the full tree, projected by G onto the same
base columns, in a Python loop; filling the same bytes, in memory fresh from the system and in
memory used before; the numpy fallback. Results go to fresh memory, or to an array given (`out`).
Then first and later use of a cache. It grows with N from line to line, with n from table to table.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from elastic_arm.dynamics import Model, build_model
from elastic_arm.robot import Robot, load_robot
from tests.helpers.full_tree import FullTree
from tests.helpers.random_arms import random_arm

REPEATS = 7
LOOP_SAMPLES = 1000


def interleaved(works: dict[str, Callable[[], object]]) -> dict[str, np.ndarray]:
    """Times of each work in every round, s; all take turns, so that whatever else the machine does
    meets all alike."""
    for work in works.values():
        work()
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(REPEATS):
        for name, work in works.items():
            start = time.perf_counter()
            work()
            times[name].append(time.perf_counter() - start)
    return {name: np.array(values) for name, values in times.items()}


def samples(
    model: Model, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random states; tilts small."""
    x, dx, ddx = rng.normal(size=(3, count, model.dof))
    x[:, 2 * model.n :] *= 0.01
    return x, dx, ddx


def base_columns(model: Model, rng: np.random.Generator) -> list[int]:
    """Indices of independent columns of Phi: each one that those before it do not make up."""
    Phi = model.regressor(*samples(model, 300, rng)).reshape(-1, len(model.Psi))
    norms = np.linalg.norm(Phi, axis=0)
    columns: list[int] = []
    basis = np.empty((len(Phi), 0))
    for k in np.flatnonzero(norms):
        rest = Phi[:, k] / norms[k]
        for _ in range(2):
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > 1e-9:
            columns.append(int(k))
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    return columns


class PinocchioLoop:
    """The peer: one call a sample, reduced by G and projected onto as many columns."""

    def __init__(self, robot: Robot, bearings: bool, columns: int) -> None:
        self.tree = FullTree(robot, bearings=bearings)
        self.columns = columns
        rng = np.random.default_rng(0)
        self.projection = np.asfortranarray(
            rng.normal(size=(10 * (self.tree.model.njoints - 1), columns))
        )

    def __call__(self, x: np.ndarray, dx: np.ndarray, ddx: np.ndarray) -> np.ndarray:
        model = self.tree.model
        data = self.tree.data
        G = self.tree.G
        Phi = np.empty((len(x), G.shape[1], self.columns))
        q = x @ G.T
        v = dx @ G.T
        a = ddx @ G.T
        for k in range(len(x)):
            Phi[k] = G.T @ (
                pin.computeJointTorqueRegressor(model, data, q[k], v[k], a[k]) @ self.projection
            )
        return Phi


def compare(
    title: str, robot: Robot, bearings: bool, counts: tuple[int, ...], rng: np.random.Generator
) -> None:
    """Print one arm's table."""
    compiled = build_model(robot, "mod3", bearings=bearings, engine="c")
    fallback = build_model(robot, "mod3", bearings=bearings, engine="numpy")
    columns = base_columns(compiled, rng)
    loop = PinocchioLoop(robot, bearings, len(columns))
    kernel = compiled.kernel("regressor", columns)
    nonzero = len(kernel.program.outputs[0].values)
    operations = len(kernel.program)
    print(
        f"\n{title}: dof {compiled.dof}, base columns {len(columns)}, not null {nonzero},"
        f" operations {operations}"
    )
    print(f"{'':20} times the Pinocchio loop's rate {'':17} times the time to fill")
    heads = ("fresh", "reused", "numpy", "reused", "fresh", "reused")
    print("        N  samples/s", *(f"{head:>9}" for head in heads))
    for count in counts:
        measure(compiled, fallback, loop, columns, samples(compiled, count, rng))


def measure(
    compiled: Model,
    fallback: Model,
    loop: PinocchioLoop,
    columns: list[int],
    state: tuple[np.ndarray, ...],
) -> None:
    """Print one line of an arm's table: medians over rounds of the ratios within each round."""
    x, dx, ddx = state
    count = len(x)
    few = slice(0, LOOP_SAMPLES)
    memory = np.empty((count, compiled.dof, len(columns)))
    times = interleaved(
        {
            "loop": lambda: loop(x[few], dx[few], ddx[few]),
            "fresh": lambda: np.empty_like(memory).fill(1.0),
            "warm": lambda: memory.fill(1.0),
            "ours": lambda: compiled.regressor(x, dx, ddx, columns),
            "ours, reused": lambda: compiled.regressor(x, dx, ddx, columns, out=memory),
            "numpy": lambda: fallback.regressor(x, dx, ddx, columns),
            "numpy, reused": lambda: fallback.regressor(x, dx, ddx, columns, out=memory),
        }
    )
    peer = times["loop"] * count / min(count, LOOP_SAMPLES)
    faster = [
        np.median(peer / times[name]) for name in ("ours", "ours, reused", "numpy", "numpy, reused")
    ]
    fills = [
        np.median(times[a] / times[b]) for a, b in (("ours", "fresh"), ("ours, reused", "warm"))
    ]
    print(
        f"{count:9d} {count / np.median(times['ours']):10.3g}",
        *(f"{value:9.4g}" for value in [*faster, *fills]),
    )


def first_and_later_use() -> None:
    """Print the time to the first regressor in a new cache, and in new processes after it."""
    code = (
        "import time, numpy as np; from elastic_arm.dynamics import build_model;from"
        " elastic_arm.robot import load_robot;from tests.helpers.random_arms import random_arm; arm"
        " = {arm}; start = time.perf_counter();m = build_model(arm, 'mod3', bearings={bearings});"
        " m.regressor(*np.zeros((3, 8, m.dof)));m.inverse_dynamics(*np.zeros((3, 8, m.dof)));"
        " print(time.perf_counter() - start)"
    )
    print(
        "\nfirst use (derived and compiled) and later use (new process) of Phi and inverse"
        " dynamics, s"
    )
    arms = {
        "nominal, 6 dof": ("load_robot()", False),
        "nominal, 12 dof": ("load_robot()", True),
        "random, n = 7": ("random_arm(7, np.random.default_rng(7))", False),
        "random, n = 12": ("random_arm(12, np.random.default_rng(12))", False),
    }
    for title, (arm, bearings) in arms.items():
        with tempfile.TemporaryDirectory() as cache:
            times = [
                subprocess.run(
                    [sys.executable, "-c", code.format(arm=arm, bearings=bearings)],
                    env={"PATH": "/usr/bin:/bin", "ELASTIC_ARM_CACHE": cache},
                    capture_output=True,
                    text=True,
                    check=True,
                ).stdout.strip()
                for _ in range(2)
            ]
        print(f"  {title:18} {float(times[0]):7.2f} {float(times[1]):7.3f}")


def main() -> None:
    """Run all."""
    rng = np.random.default_rng(0)
    nominal = load_robot()
    compare("nominal arm, bearings locked", nominal, False, (100, 1000, 10_000, 100_000), rng)
    compare("nominal arm with bearings", nominal, True, (1000, 10_000, 40_000), rng)
    for n in (3, 6, 7, 12):
        compare(
            f"random arm, n = {n}", random_arm(n, np.random.default_rng(n)), False, (10_000,), rng
        )
    first_and_later_use()


if __name__ == "__main__":
    main()
