"""Forward simulation against MuJoCo, in one run. ``python -m benchmarks.bench_simulation``.

The peer: the same arm in MuJoCo, every component a body, couplers as joint-equality constraints,
RK4 (and the two implicit Euler schemes) at 1e-4 s, all steps in one call. The error is that after
half a second of free fall against RK4 in steps of 1e-5 s of the engine itself; MuJoCo's Euler
schemes need smaller steps for splines this light. Then the engine that needs no compiler, and
growth with n.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import mujoco
import numpy as np

from elastic_arm.effects import EffectInstance, parse
from elastic_arm.robot import Robot, load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, Simulator
from elastic_arm.studies.paper.virtual_prototype.mechanism import BUSHING, Bushing, build_spec
from tests.helpers.random_arms import random_arm

REPEATS = 7
STEP = 1e-4
FALL = 0.5


def rates(*work: Callable[[], int]) -> list[float]:
    """Median steps/s of several engines, run in turn so that a busy machine is unfair to none."""
    measured: list[list[float]] = [[] for _ in work]
    for job in work:
        job()
    for _ in range(REPEATS):
        for own, job in zip(measured, work, strict=True):
            start = time.perf_counter()
            steps = job()
            own.append(steps / (time.perf_counter() - start))
    return [float(np.median(own)) for own in measured]


def ours(
    robot: Robot,
    *,
    bearings: bool = False,
    engine: str = "c",
    samples: int = 2000,
    effects: tuple[EffectInstance, ...] = (),
) -> Callable[[], int]:
    """Job: samples of ten steps under held torques."""
    simulator = Simulator(
        robot,
        SimulationSettings(
            bearings=bearings, sensors=Sensors.exact(), engine=engine, effects=effects
        ),
    )
    reference = np.zeros((samples, 3 * robot.n))
    reference[:, 2 * robot.n :] = simulator.state.command
    loop = simulator._loop
    loop.gains[:2] = 0.0

    def job() -> int:
        simulator.reset(np.zeros(robot.n))
        done = simulator.integrator.run(loop, reference, simulator.state)
        return 2 * loop.half_steps * len(done.y)

    return job


class MujocoArm:
    """The arm in MuJoCo, as performance peers build it: gear ratios are constraints between
    joints."""

    def __init__(
        self, robot: Robot, integrator: int, *, bearings: bool = False, step: float = STEP
    ) -> None:
        spec = build_spec(robot, Bushing())
        spec.option.timestep = step
        spec.option.integrator = integrator
        rigid = [axis for axis in BUSHING if axis in "xyz" or (not bearings and axis != "about_z")]
        for joint in robot.joints:
            for axis in rigid:
                spec.delete(spec.joint(f"{joint.name}.{axis}"))
            gear = joint.transmission
            assert gear is not None
            for part, ratio in (
                ("rotor", gear.r_tot),
                ("wave_generator", gear.harmonic_drive_ratio),
            ):
                coupler = spec.add_equality(
                    type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT
                )
                coupler.name1 = f"{joint.name}.{part}"
                coupler.name2 = f"{joint.name}.spline"
                coupler.data[:2] = 0.0, ratio
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        names = [f"{joint.name}.spline" for joint in robot.joints]
        self.theta = [self.model.joint(name).qposadr[0] for name in names]
        self.drive = [
            self.model.joint(f"{joint.name}.about_z").qposadr[0] for joint in robot.joints
        ]

    def job(self, steps: int) -> Callable[[], int]:
        """Job: free fall from zero."""

        def run() -> int:
            mujoco.mj_resetData(self.model, self.data)
            mujoco.mj_step(self.model, self.data, nstep=steps)
            return steps

        return run

    def fallen(self, seconds: float) -> np.ndarray:
        """Link angles after free fall, springs unloaded at first."""
        self.job(round(seconds / self.model.opt.timestep))()
        qpos = self.data.qpos
        return np.array([qpos[t] + qpos[d] for t, d in zip(self.theta, self.drive, strict=True)])


def fallen(robot: Robot, step: float, bearings: bool) -> np.ndarray:
    """Link angles after free fall of our arm, springs unloaded at first."""
    rate = 100.0
    simulator = Simulator(
        robot,
        SimulationSettings(
            bearings=bearings,
            sensors=Sensors.exact(),
            rate=rate,
            substeps=2 * round(0.5 / (rate * step)),
        ),
    )
    simulator.state.y[:] = 0.0
    simulator.drive(np.zeros((round(FALL * rate), robot.n)))
    return simulator.state.y[: robot.n].copy()


def compare(robot: Robot, bearings: bool) -> None:
    """Print one table: steps/s, ratio to MuJoCo's RK4, error."""
    schemes = {"RK4": "mjINT_RK4", "Euler": "mjINT_EULER", "implicitfast": "mjINT_IMPLICITFAST"}
    peers = {
        name: MujocoArm(robot, getattr(mujoco.mjtIntegrator, kind), bearings=bearings)
        for name, kind in schemes.items()
    }
    job = ours(robot, bearings=bearings)
    all_rates = rates(job, *(peer.job(2000) for peer in peers.values()))
    exact = fallen(robot, 1e-5, bearings)
    fine = MujocoArm(robot, mujoco.mjtIntegrator.mjINT_RK4, bearings=bearings, step=1e-5).fallen(
        FALL
    )
    errors = [np.abs(fallen(robot, STEP, bearings) - exact).max()]
    errors += [np.abs(peer.fallen(FALL) - fine).max() for peer in peers.values()]
    dof = 12 if bearings else 6
    print(f"\n{dof:2d} dof, step 1e-4 s {'steps/s':>19} {'x MuJoCo RK4':>13} {'error, rad':>11}")
    names = ("ours, C, RK4", *(f"MuJoCo {name}" for name in peers))
    for name, rate, error in zip(names, all_rates, errors, strict=True):
        said = f"{error:11.1e}" if error < 0.1 else f"{'diverges':>11}"
        print(f"{name:27} {rate:10.3g} {rate / all_rates[1]:13.1f} {said}")
    print(
        f"ours against MuJoCo's soft couplers after {FALL} s: {np.abs(exact - fine).max():.1e} rad"
    )


def main() -> None:
    """Run all."""
    arm = load_robot()
    compare(arm, False)
    compare(arm, True)
    effects = tuple(
        parse(text)
        for text in (
            "coulomb_friction:joint_2:torque=14",
            "hysteresis:joint_2:torque=5,width=1e-4",
            "transmission_error:joint_3:amplitude=3e-5",
        )
    )
    jobs = {
        "ours, C": ours(arm),
        "ours, C, three effects": ours(arm, effects=effects),
        "ours, no compiler": ours(arm, engine="casadi", samples=200),
    }
    print()
    for name, rate in zip(jobs, rates(*jobs.values()), strict=True):
        print(f"{name:27} {rate:10.3g} steps/s")
    print(
        "\ngrowth with N: steps/s of "
        + ", ".join(f"{rate:.3g} ({count} steps)" for count, rate in by_length(arm))
    )
    print(
        f"\n{'n':>3} {'steps/s':>10} {'first use, s':>13} {'new process, s':>15}"
        f" {'same process, s':>16}"
    )
    for n in (3, 6, 7, 12):
        (rate,) = rates(ours(random_arm(n, np.random.default_rng(n)), samples=500))
        print(f"{n:3d} {rate:10.3g} {{:13.2f}} {{:15.3f}} {{:16.3f}}".format(*uses(n)))


def by_length(robot: Robot) -> list[tuple[int, float]]:
    """Steps/s of calls of a hundred to twenty thousand samples, ten steps each."""
    lengths = (100, 2000, 20_000)
    found = rates(*(ours(robot, samples=samples) for samples in lengths))
    return [(10 * samples, rate) for samples, rate in zip(lengths, found, strict=True)]


def uses(n: int) -> tuple[float, float, float]:
    """Times to make a simulator: with an empty cache, in a new process after it, and again
    there."""
    code = (
        "import time, numpy as np; from tests.helpers.random_arms import random_arm;from"
        f" elastic_arm.simulation import Simulator; arm = random_arm({n},"
        f" np.random.default_rng({n}));start = time.perf_counter(); Simulator(arm); middle ="
        " time.perf_counter(); Simulator(arm);print(middle - start, time.perf_counter() - middle)"
    )
    with tempfile.TemporaryDirectory() as cache:
        lines = [
            subprocess.run(
                [sys.executable, "-c", code],
                env={"PATH": "/usr/bin:/bin", "ELASTIC_ARM_CACHE": cache},
                capture_output=True,
                text=True,
                check=True,
            ).stdout.split()
            for _ in range(2)
        ]
    return float(lines[0][0]), float(lines[1][0]), float(lines[1][1])


if __name__ == "__main__":
    main()
