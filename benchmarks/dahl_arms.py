"""Six-axis arms whose friction is of no law of the catalogue, and what the diagnosis says of them.

    python -m benchmarks.dahl_arms [--seed 1] [--only REGEX] [--out runs/dahl_arms]
    [--data ../shared/data]

Torques are Pinocchio's inverse dynamics of a UR5e along prescribed motions, plus at each joint

    F = (F_c (1 + b exp(-(w/0.12)²)) (1 + r (1 - exp(-t/15))) + m |tau|) (z + a) + F_v w
    dz/dt = (w - z |w|) / d                                              (Dahl 1968)

with d of 1 to 8 mrad: dry friction turns over within a distance and differs by direction (a, up to
6 %), speed (b, up to 12 %), load (m, up to 3 %) and time (r, up to 8 %). Masses, centres of mass,
armatures and torque constants differ from the URDF, which states no friction. One effect is added
to most arms. Friction and armature of every joint are allowed as causes, load-dependent and thermal
friction too, as they are there; all else is a false cause.
"""

import argparse
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline

from benchmarks.judge import Arm, answer, row
from elastic_arm.arrays import Array
from elastic_arm.recording import Recording, Side, write_recording

RATE = 250.0
SECONDS = 25.0
DRY = np.array([9.0, 11.0, 6.0, 1.6, 1.5, 1.2])  # Nm
VISCOUS = np.array([10.0, 12.0, 7.0, 1.8, 1.6, 1.3])  # Nm s/rad
ARMATURE = np.array([3.4, 3.4, 1.25, 0.33, 0.33, 0.33])  # kg m²
POSE = np.array([0.0, -1.4, 1.2, -1.3, -1.5, 0.0])  # rad
STEPS = 8  # of Dahl's equation a sample
PARTS = "identify", "validate"
ALLOWED = (
    "coulomb_friction", "viscous_friction", "rotor_inertia_mismatch", "load_dependent_friction",
    "thermal_friction",
)  # fmt: skip


class DahlArm:
    """One arm, with its numbers drawn."""

    def __init__(self, model: pin.Model, rng: np.random.Generator) -> None:
        n = model.nq
        self.model = model.copy()
        self.names = [name for name in model.names if name != "universe"]
        for body in range(1, n + 1):
            inertia = self.model.inertias[body]
            inertia.mass *= 1.0 + 0.03 * rng.normal()
            inertia.lever = inertia.lever + 0.004 * rng.normal(size=3)
            self.model.inertias[body] = inertia
        self.dry = DRY * rng.uniform(0.7, 1.3, n)
        self.viscous = VISCOUS * rng.uniform(0.7, 1.3, n)
        self.armature = ARMATURE * (1.0 + 0.05 * rng.normal(size=n))
        self.gain = 1.0 + 0.04 * rng.normal(size=n)
        self.distance = rng.uniform(0.001, 0.008, n)
        self.by_direction = rng.uniform(-0.06, 0.06, n)
        self.by_speed = rng.uniform(0.0, 0.12, n)
        self.by_load = rng.uniform(0.0, 0.03, n)
        self.by_time = rng.uniform(-0.08, 0.02, n)
        self.spring = np.zeros(n)
        self.delay = 0.0
        self.zone: tuple[int, float] | None = None

    def torques(self, t: Array, q: Array) -> Array:
        """Return the motor torques (N, n) Nm along angles (N, n) rad at times (N,) s."""
        course = make_interp_spline(t, q, k=5)
        dq = course.derivative(1)(t)
        ddq = course.derivative(2)(t)
        data = self.model.createData()
        motions = zip(q, dq, ddq, strict=True)
        load = np.array([pin.rnea(self.model, data, *one) for one in motions])
        load += self.spring * (q - POSE)
        tau = load + self.armature * ddq
        for j in range(q.shape[1]):
            tau[:, j] += self._friction(j, t, q[:, j], dq[:, j], load[:, j])
        late = [np.interp(t - self.delay, t, column) for column in tau.T]
        return np.array(late).T * self.gain

    def _friction(self, j: int, t: Array, q: Array, w: Array, load: Array) -> Array:
        dry = self.dry[j] * (1.0 + self.by_speed[j] * np.exp(-((w / 0.12) ** 2)))
        dry *= 1.0 + self.by_time[j] * (1.0 - np.exp(-t / 15.0))
        dry += self.by_load[j] * np.abs(load)
        if self.zone is not None and self.zone[0] == j:
            dry *= 1.0 + 1.2 * np.exp(-(((q - self.zone[1]) / 0.12) ** 2))
        return dry * (dahl(t, w, self.distance[j]) + self.by_direction[j]) + self.viscous[j] * w


def dahl(t: Array, w: Array, distance: float) -> Array:
    """Return z (N,) of Dahl's equation along velocities (N,) rad/s, from rest."""
    step = (t[1] - t[0]) / STEPS
    found = np.zeros(len(w))
    z = 0.0
    for k in range(1, len(w)):
        for share in (np.arange(STEPS) + 0.5) / STEPS:
            speed = w[k - 1] + (w[k] - w[k - 1]) * share
            z += (speed - z * abs(speed)) / distance * step
        found[k] = z
    return found


def motion(n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return times (N,) s and angles (N, n) rad of a motion of five harmonics, up to 1.5 rad/s."""
    t = np.arange(int(SECONDS * RATE)) / RATE
    rates = 2.0 * np.pi * 0.08 * np.arange(1, 6)
    waves = np.sin(t[:, None, None] * rates + rng.uniform(0.0, 2.0 * np.pi, (n, 5)))
    q = (waves * rng.normal(size=(n, 5))).sum(axis=2)
    fastest = np.abs(np.gradient(q, t, axis=0)).max(axis=0)
    sizes = np.minimum(rng.uniform(0.5, 1.1, n) / np.abs(q).max(axis=0), 1.5 / fastest)
    return t, q * sizes + POSE


# --- What is added to an arm: a function that changes it and returns the true effects
# --------------------------------------------------------------------------------------------------


def truth(effect: str, joint: str | None, **parameters: float) -> list[dict[str, Any]]:
    """Return an effect as the judge reads it."""
    return [{"effect": effect, "joint": joint, "parameters": parameters, "phases": []}]


def clean(arm: DahlArm, j: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Nothing."""
    return []


def payload(arm: DahlArm, j: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """A load of 1.2 to 2.5 kg at the flange."""
    mass = float(rng.uniform(1.2, 2.5))
    last = len(arm.names)
    carried = pin.Inertia(mass, np.array([0.03, 0.0, 0.06]), 0.002 * mass * np.eye(3))
    arm.model.inertias[last] = arm.model.inertias[last] + carried
    return truth("payload", arm.names[-1], mass=mass)


def stribeck(arm: DahlArm, j: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Dry friction that is about twice as large at rest."""
    arm.by_speed[j] = rng.uniform(0.8, 1.2)
    return truth("stribeck_friction", arm.names[j])


def gain(arm: DahlArm, j: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """A torque constant that is off by a factor of 1.8."""
    arm.gain[j] = rng.choice([1.8, 1.0 / 1.8])
    return truth("motor_torque_gain", arm.names[j], gain=float(arm.gain[j]))


def delay(arm: DahlArm, j: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Torques that are 8 to 15 ms late."""
    arm.delay = float(rng.uniform(0.008, 0.015))
    return truth("time_delay", None, delay=arm.delay)


def spring(arm: DahlArm, j: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """A spring at the second joint."""
    arm.spring[1] = rng.uniform(25.0, 45.0)
    return truth("joint_spring", arm.names[1], stiffness=float(arm.spring[1]))


def zone(arm: DahlArm, j: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """A worn place, which is in no catalogue."""
    arm.zone = j, float(POSE[j] + rng.uniform(-0.2, 0.2))
    return []


ADDED: tuple[Callable[..., list[dict[str, Any]]], ...] = (
    clean, clean, payload, stribeck, gain, delay, spring, zone,
)  # fmt: skip


def question(
    number: int, seed: int, model: pin.Model, robot: Path, folder: Path, only: str
) -> Arm | None:
    """Draw an arm, record it on two motions, and return what is asked; None if it is not chosen."""
    add = ADDED[number % len(ADDED)]
    name = f"dahl_{seed}_{number:02d}_{add.__name__}"
    if not re.search(only, name):
        return None
    rng = np.random.default_rng([seed, number])
    arm = DahlArm(model, rng)
    effects = add(arm, int(rng.integers(0, model.nq)), rng)
    bags = []
    for part in PARTS:
        t, q = motion(model.nq, rng)
        tau = arm.torques(t, q)
        noise = np.maximum(0.02 * np.abs(tau).max(axis=0), 0.05)
        seen = np.round((q + 1e-5 * rng.normal(size=q.shape)) / 2e-5) * 2e-5
        stamps = (t * 1e9).astype(np.int64)
        read = tau + noise * rng.normal(size=tau.shape)
        bag = f"bags/{name}_{part}"
        shutil.rmtree(folder / bag, ignore_errors=True)
        write_recording(
            folder / bag, Recording(tuple(arm.names), None, Side(stamps, seen, None, read))
        )
        bags.append(bag)
    foreign = add is zone
    return Arm(
        name, "dahl", "foreign" if foreign else "single" if effects else "clean",
        bags[:1], bags[1:], truth=effects,
        allowed=[[effect, joint] for joint in arm.names for effect in ALLOWED],
        verdicts=["unknown"] if foreign else ["explained"], complete=True,
        robot=str(robot.resolve()),
    )  # fmt: skip


def main() -> None:
    """Draw the arms, ask the diagnosis and print its answers."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=len(ADDED))
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path, default=Path("runs/dahl_arms"))
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    asked = parser.parse_args()
    robot = asked.data / "ur5e_with_tool" / "ur5e.urdf"
    model = pin.buildModelFromUrdf(str(robot))
    (asked.out / "bags").mkdir(parents=True, exist_ok=True)
    rows = []
    for number in range(asked.count):
        arm = question(number, asked.seed, model, robot, asked.out, asked.only)
        if arm is None:
            continue
        rows.append(row(arm, answer(arm, asked.out)))
        said = rows[-1]
        print(f"{arm.name}: {said['verdict']}, {'right' if said['right'] == '1' else 'wrong'}")
        print(f"    {said['causes']}\n    false: {said['false_causes'] or 'none'}", flush=True)
    (asked.out / "answers.json").write_text(json.dumps(rows, indent=1))
    right = sum(one["right"] == "1" for one in rows)
    false = sum(bool(one["false_causes"]) for one in rows)
    print(f"{len(rows)} arms: {right} right, {false} with a false cause of 0.9 and more")


if __name__ == "__main__":
    main()
