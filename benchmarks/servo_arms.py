"""Servo arms in MuJoCo for the judge: commands and positions alone, one thing withheld, all else ordinarily off.

Arms of 3 to 5 joints like SO-101. The description is the MJCF that the arm was drawn as; of the true one masses are off
by 6 %, centres by 3 mm, moments by 8 %, armatures by 6 %, friction by 20 % and both gains of a servo together by 10 %
(standard deviations). `servo` has 30 to 100 Hz and 12 bits, `position` 250 to 500 Hz and 17 bits.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.recording import write_recording
from elastic_arm.robot.mjcf import open_mjcf

SEEDS = {"servo": 720104, "position": 720105}
RATES, BITS, SECONDS = {"servo": (30, 50, 100), "position": (250, 500)}, {"servo": 12, "position": 17}, (20, 12)
FOREIGN = "lower_torque_limit"  # no law of the catalogue: a servo that gives less torque than its data sheet
KINDS = (
    None, None, "coulomb_friction", "coulomb_friction", "viscous_friction", "payload", "position_gain", "position_gain",
    "velocity_gain", "command_delay", "command_delay", "rotor_inertia_mismatch", "joint_spring", FOREIGN,
)  # fmt: skip
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0")


@dataclass(frozen=True)
class Joint:
    """A joint and its link, of a servo arm as MJCF has them."""

    length: float
    mass: float
    com: tuple[float, ...]
    moments: tuple[float, ...]
    numbers: dict[str, float] = field(default_factory=dict)  # attributes of the joint
    servo: dict[str, float] = field(default_factory=dict)  # of its actuator
    payload: float = 0.0


def described(rng: np.random.Generator) -> list[Joint]:
    """Draw an arm."""
    count, size = int(rng.integers(3, 6)), float(rng.uniform(0.8, 1.3))
    joints = []
    for k in range(count):
        length, mass = size * float(rng.uniform(0.08, 0.2)), size**3 * float(rng.uniform(0.25, 0.5)) * 0.8**k
        slender = mass * length**2 / 10
        numbers = {"armature": float(rng.uniform(0.015, 0.03)), "damping": 0.05, "frictionloss": 0.04}
        servo = {"kp": float(rng.uniform(15, 25)), "kv": float(rng.uniform(0.4, 0.8))}
        com = (0.0, 0.05 * length, 0.5 * length)
        joints.append(Joint(length, mass, com, (slender, slender, 0.2 * slender), numbers, servo))
    return joints


def ordinary(joints: list[Joint], rng: np.random.Generator) -> list[Joint]:
    """Return an arm as it is built after a description."""

    def off(share: float) -> float:
        return float(np.clip(1.0 + share * rng.normal(), 0.5, 1.5))

    built = []
    for one in joints:
        moments, gain, friction = off(0.08), off(0.1), off(0.2)
        numbers = {**one.numbers, "armature": off(0.06) * one.numbers["armature"]}
        numbers |= {name: friction * numbers[name] for name in ("damping", "frictionloss")}
        built.append(
            replace(
                one,
                mass=off(0.06) * one.mass,
                com=tuple(float(c + 0.003 * rng.normal()) for c in one.com),
                moments=tuple(moments * m for m in one.moments),
                numbers=numbers,
                servo={name: gain * value for name, value in one.servo.items()},
            )
        )
    return built


def with_effect(
    joints: list[Joint], kind: str | None, step: float, rng: np.random.Generator
) -> tuple[list[Joint], list[dict[str, Any]]]:
    """Return an arm with one thing that its description lacks, and that as the judge has it."""
    joints, k = list(joints), int(rng.integers(1, len(joints)))
    own, parameters = joints[k], {}
    u = float(rng.uniform())
    if kind is None:
        return joints, []
    if kind in ("coulomb_friction", "viscous_friction"):
        number, more = ("frictionloss", 0.1 + 0.15 * u) if kind.startswith("c") else ("damping", 0.3 + 0.4 * u)
        joints[k] = replace(own, numbers={**own.numbers, number: own.numbers[number] + more})
        parameters = {"torque" if kind.startswith("c") else "coefficient": joints[k].numbers[number]}
    elif kind == "payload":
        k = len(joints) - 1
        joints[k] = replace(joints[k], payload=(0.6 + 0.6 * u) * joints[k].mass)
        parameters = {"mass": joints[k].payload}
    elif kind in ("position_gain", "velocity_gain"):
        number = "kp" if kind == "position_gain" else "kv"
        joints[k] = replace(own, servo={**own.servo, number: (1.8 + 0.7 * u) * own.servo[number]})
    elif kind == "command_delay":
        delay = 0.015 + 0.03 * u
        late = {"delay": delay, "nsample": int(np.ceil(delay / step)) + 2}
        joints, k = [replace(one, servo={**one.servo, **late}) for one in joints], -1
        parameters = {"delay": delay}
    elif kind == "rotor_inertia_mismatch":
        joints[k] = replace(own, numbers={**own.numbers, "armature": (2.0 + u) * own.numbers["armature"]})
    elif kind == "joint_spring":
        joints[k] = replace(own, numbers={**own.numbers, "stiffness": 1.0 + u, "springref": 0.3})
    else:
        joints[k] = replace(own, servo={**own.servo, "limit": 1.0 + 0.5 * u})
        return joints, []
    joint = None if k == -1 else f"joint_{k + 1}"
    return joints, [{"effect": kind, "joint": joint, "parameters": parameters, "phases": []}]


def mjcf(joints: list[Joint], step: float) -> str:
    """Return an arm as MJCF."""

    def written(attributes: dict[str, float]) -> str:
        return " ".join(f'{name}="{value:.9g}"' for name, value in attributes.items())

    bodies, place = "", "0 0 0"
    for k, one in enumerate(joints):
        com, moments = (" ".join(f"{v:.9g}" for v in values) for values in (one.com, one.moments))
        bodies += f'<body name="link_{k + 1}" pos="{place}"><joint name="joint_{k + 1}" axis="{AXES[k]}" '
        bodies += f'{written(one.numbers)}/><inertial pos="{com}" mass="{one.mass:.9g}" diaginertia="{moments}"/>'
        if one.payload:
            inertial = f'<inertial pos="0 0 0" mass="{one.payload:.9g}" diaginertia="1e-6 1e-6 1e-6"/>'
            bodies += f'<body name="payload" pos="0 0 {one.length:.9g}">{inertial}</body>'
        place = f"0 0 {one.length:.9g}"
    servos = ""
    for k, one in enumerate(joints):
        limit = one.servo.get("limit", 10.0)
        own = {name: value for name, value in one.servo.items() if name != "limit"}
        servos += f'<position joint="joint_{k + 1}" {written(own)} forcerange="-{limit:.9g} {limit:.9g}"/>'
    return (
        f'<mujoco model="servo_arm"><compiler angle="radian"/><option timestep="{step:.12g}" integrator="RK4"/>'
        f'<default><joint solreffriction="0.002 1"/></default><worldbody><body name="base">{bodies}'
        f"{'</body>' * len(joints)}</body></worldbody><actuator>{servos}</actuator></mujoco>"
    )


def commands(rate: float, seconds: float, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return commands (N, n) rad of several frequencies, from rest."""
    t, f = np.arange(round(seconds * rate)) / rate, np.array([0.1, 0.23, 0.41, 0.67, 0.97, 1.2])
    size, phase = rng.normal(size=(6, n)) / (0.6 + f)[:, None], rng.uniform(0, 2 * np.pi, (6, n))
    motion = np.einsum("fj,ftj->tj", size, np.sin(2 * np.pi * f[:, None, None] * t[:, None] + phase[:, None]))
    start = np.clip(t, 0.0, 1.0)[:, None]
    middle = np.array([0.0, 0.5, 0.7, 0.0, 0.5])[:n]
    return np.asarray(middle + 0.5 * motion / motion.std(axis=0) * start**2 * (3.0 - 2.0 * start))


def drawn(arms: Path, level: str) -> Iterator[dict[str, Any]]:
    """Draw and record the arms of a level; yield what is asked of each, as the judge takes it."""
    for number, kind in enumerate(KINDS):
        rng, name = np.random.default_rng((SEEDS[level], number)), f"{level}_{number:03d}_{kind or 'clean'}"
        rate = float(rng.choice(RATES[level]))
        step = 1.0 / rate / np.ceil(1e3 / rate)
        stated = described(rng)
        true, truth = with_effect(ordinary(stated, rng), kind, step, rng)
        bags = [f"bags/{name}_{part}" for part in ("identify", "validate")]
        for folder in ("robots", "bags"):
            (arms / folder).mkdir(parents=True, exist_ok=True)
        robot, hidden = arms / "robots" / f"{name}.xml", arms / "robots" / f"{name}_true.xml"
        robot.write_text(mjcf(stated, step))
        hidden.write_text(mjcf(true, step))
        arm = open_mjcf(hidden)
        for bag, seconds in zip(bags, SECONDS, strict=True):
            if not (arms / bag / "metadata.yaml").is_file():
                told = commands(rate, seconds, len(true), rng)
                write_recording(arms / bag, record_commands(arm, told, rate=rate, bits=BITS[level]))
        hidden.unlink()
        asked = {"fit": bags[:1], "judge": bags[1:], "robot": f"robots/{name}.xml", "refit": True}
        verdicts = ["unknown"] if kind == FOREIGN else ["none", "explained"]
        kinds = {None: "clean", FOREIGN: "foreign"}
        yield {"name": name, "level": level, "kind": kinds.get(kind, "single"), "truth": truth, **asked} | {
            "verdicts": verdicts
        }


def main() -> None:
    """Draw and record the arms of both levels into a folder, and print what is withheld of each."""
    for level in SEEDS:
        for one in drawn(Path(sys.argv[1]), level):
            print(one["name"], *(truth["joint"] or "all joints" for truth in one["truth"]))


if __name__ == "__main__":
    main()
