"""Diagnosis of servo arms in MuJoCo beside a fit by CMA-ES as PACE has it: armature, damping,
friction, bias, a delay.

    python -m benchmarks.bench_servo_fit --evaluations 600

It uses CMA-ES after `pip install cma`, and differential evolution without it.

Each arm is built ordinarily off its description and has one thing more: friction, late commands, an
elastic drive, or play. Both start from the same recording of commands and positions. What is
printed: the closed-loop error of positions under the commands of another recording (mrad, rms over
joints), of the description, of both results and of the true arm, the processor's time, and what is
said. Elasticity and play lie behind the encoder, as in a servo's gears.
"""

import argparse
import re
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from elastic_arm.cli.diagnose import correct
from elastic_arm.cli.mujoco.corrected import Correction
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.effects import EFFECTS
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.servo_arms import (
    commands,
    described,
    mjcf,
    ordinary,
    with_effect,
)

RATE = 250.0
STEP = 1e-3
SECONDS = (16.0, 10.0)
CODE = 2 * np.pi / 2**17
FITTED = 8.0  # s that each simulation of the fit lasts
# of logarithms, where the search starts
DEVIATION = {"armature": 0.3, "damping": 0.7, "frictionloss": 0.7}
BIAS = 0.01  # rad, the same
DELAY = 0.01  # s, the same
KINDS = ("coulomb_friction", "command_delay", "elasticity", "play")
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Told:
    """Commands (N, n) rad at RATE, and the angles that followed."""

    r: Array
    q: Array

    def recording(self, names: tuple[str, ...]) -> Recording:
        """Return them as a recording."""
        stamps = np.round(1e9 * np.arange(len(self.r)) / RATE).astype(np.int64)
        angles = CODE * np.round(self.q / CODE)
        return Recording(
            names, link=Side(stamps, position=angles), reference=Side(stamps, position=self.r)
        )


def moved(model: mujoco.MjModel, r: Array, delay: float = 0.0) -> Array:
    """Return the angles (N, n) of the servos' joints under commands (N, n), from rest at the
    first."""
    every = round(1.0 / (RATE * STEP))
    n = model.nu
    places = model.jnt_qposadr[model.actuator_trnid[:n, 0]]
    data = mujoco.MjData(model)
    data.qpos[places] = r[0]
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    late = np.clip(np.arange(len(r) * every) - round(delay / STEP), 0, None) // every
    found, _ = rollout.rollout(model, data, state[None], r[late][None])
    q = found[0][:, 1 + places]  # the time first
    return np.vstack([r[:1], q])[:-1:every]


def true_arm(text: str, kind: str, joint: int) -> str:
    """Return an arm whose joint has a spring, or play, between its encoder and its link."""
    if kind not in ("elasticity", "play"):
        return text
    name = f"joint_{joint + 1}"
    axis = re.search(rf'name="{name}" axis="([^"]*)"', text)
    assert axis is not None
    play = 'limited="true" range="-0.015 0.015" damping="0.002"'
    flex = 'stiffness="40" damping="0.05"' if kind == "elasticity" else play
    # The motor turns a body of hardly any mass, in which the link turns a little further.
    light = '<inertial pos="0 0 0" mass="1e-4" diaginertia="1e-6 1e-6 1e-6"/>'
    inner = f'<body name="link_{joint + 1}"><joint name="flex" axis="{axis[1]}" {flex}/>'
    pattern = rf'<body name="link_{joint + 1}"( pos="[^"]*">)(<joint name="{name}"[^>]*>)'
    text = re.sub(pattern, rf'<body name="motor"\1\2{light}{inner}', text)
    return text.replace("</body></worldbody>", "</body></body></worldbody>")


def fitted(text: str, told: Told, evaluations: int, seed: int) -> tuple[Array, float]:
    """Return the numbers found by CMA-ES, or by differential evolution where there is no `cma`, and
    s of processor."""
    begin = time.process_time()
    model = mujoco.MjModel.from_xml_string(text)
    n = model.nu
    count = round(FITTED * RATE)
    part = Told(told.r[:count], told.q[:count])

    def cost(x: Array) -> float:
        q = moved(*changed(model, text, x, part.r))
        return (
            float(np.mean((q + BIAS * x[3 * n : 4 * n] - part.q) ** 2))
            if np.isfinite(q).all()
            else 1e3
        )

    try:
        import cma

        options = {"maxfevals": evaluations, "verbose": -9, "seed": seed + 1}
        best = np.asarray(cma.fmin(cost, np.zeros(4 * n + 1), 1.0, options)[0])
    except ImportError:
        from scipy.optimize import differential_evolution

        bounds = [(-3.0, 3.0)] * (4 * n + 1)
        rounds = max(1, evaluations // (4 * n + 1) // 2 - 1)
        best = differential_evolution(
            cost, bounds, popsize=2, maxiter=rounds, polish=False, rng=seed
        ).x
    return best, time.process_time() - begin


def changed(model: mujoco.MjModel, text: str, x: Array, r: Array) -> tuple[Any, Array, float]:
    """Return the arguments of :func:`moved` at numbers (4 n + 1,), in deviations of the start."""
    n = model.nu
    stated = mujoco.MjModel.from_xml_string(text)
    for k, (name, std) in enumerate(DEVIATION.items()):
        values = np.asarray(getattr(stated, f"dof_{name}")).reshape(-1) * np.exp(
            std * x[k * n : (k + 1) * n]
        )
        getattr(model, f"dof_{name}")[:] = values.reshape(getattr(model, f"dof_{name}").shape)
    return model, r, abs(DELAY * x[-1])


def error(q: Array, told: Told) -> float:
    """Return the error of positions, mrad."""
    return 1e3 * float(np.sqrt(np.mean((q - told.q) ** 2)))


def recorded(kind: str, seed: int) -> tuple[str, list[Told]]:
    """Return the description of an arm, and what was recorded of the true one."""
    rng = np.random.default_rng((seed, KINDS.index(kind)))
    stated = described(rng)[:3]
    built = ordinary(stated, rng)
    if kind in ("coulomb_friction", "command_delay"):
        built, _ = with_effect(built, kind, np.full(3, 2.0), rng)
    model = mujoco.MjModel.from_xml_string(true_arm(mjcf(built, STEP), kind, 1))
    told = list[Told]()
    for seconds in SECONDS:
        r = commands(RATE, seconds, 3, rng)
        told.append(Told(r, moved(model, r)))
    return mjcf(stated, STEP), told


def compared(kind: str, seed: int, evaluations: int) -> list[str]:
    """Return a row of the table."""
    text, told = recorded(kind, seed)
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder, "arm.xml")
        base.write_text(text)
        robot = load_robot(base)
        fit, judge = (
            replace(one.recording(robot.joint_names), source=f"run_{k}")
            for k, one in enumerate(told)
        )
        begin = time.process_time()
        found = diagnose([fit], Question(robot, refit=True), [judge])
        correction = Correction(base, None, None, EFFECTS)
        written = correct(found, robot, Path(folder), correction, [judge], [fit])
        ours = time.process_time() - begin
        file = correction.path(Path(folder))
        written_file = base if written.robot is None or file is None else file
        corrected = moved(mujoco.MjModel.from_xml_path(str(written_file)), told[1].r)
    best, theirs = fitted(text, told[0], evaluations, seed)
    model = mujoco.MjModel.from_xml_string(text)
    described_q = moved(model, told[1].r)
    fitted_q = moved(*changed(model, text, best, told[1].r)) + BIAS * best[9:12]
    said = "; ".join(f"{c.effect}:{c.joint or 'all'}" for c in found.causes) or "no cause"
    errors = [error(q, told[1]) for q in (described_q, corrected, fitted_q)]
    joints = 1e3 * np.sqrt([np.mean((q - told[1].q) ** 2, axis=0) for q in (corrected, fitted_q)])
    return [
        kind,
        *(f"{e:.2f}" for e in errors),
        f"{np.sum(joints[0] <= joints[1])} of {joints.shape[1]}",
        f"{ours:.0f}",
        f"{theirs:.0f}",
        f"{found.verdict}: {said}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--evaluations", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=KINDS, help="one thing that is withheld")
    asked = parser.parse_args()
    print(
        "withheld | described mrad | diagnosis mrad | CMA-ES mrad | joints no farther"
        " | diagnosis s | CMA-ES s | the diagnosis says"
    )
    for kind in [asked.only] if asked.only else KINDS:
        print(" | ".join(compared(kind, asked.seed, asked.evaluations)), flush=True)


if __name__ == "__main__":
    main()
