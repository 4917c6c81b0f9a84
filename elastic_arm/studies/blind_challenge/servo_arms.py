"""Servo arms in MuJoCo: only commands and positions, ordinary deviations, and effects that the
description lacks.

The arms have 3 to 5 joints, like SO-101. The description is the drawn MJCF. In the true arm, masses
are off by 6 %, centres by 3 mm, moments by 8 %, armatures by 6 %, friction by 20 % and both gains
of a servo together by 10 % (standard deviations).
"""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.mujoco.recorder import record_commands
from elastic_arm.recording import write_recording
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf
from elastic_arm.studies.blind_challenge.draw import MODEL_DISTANCE, Request, bags_of
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.levels import Level

STEP = 1e-3  # s, the most that MuJoCo steps
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
MOTION_HZ = np.array([0.1, 0.23, 0.41, 0.67, 0.97, 1.2])
LIMIT = 30.0  # Nm, that no motion reaches


@dataclass(frozen=True)
class ServoJoint:
    """A joint and its link, of a servo arm as MJCF has them."""

    length: float
    mass: float
    com: tuple[float, ...]
    moments: tuple[float, ...]
    numbers: dict[str, Any] = field(default_factory=dict)  # attributes of the joint
    servo: dict[str, float] = field(default_factory=dict)  # of its actuator
    # of its controller, which no actuator of MuJoCo has
    beside: dict[str, Any] = field(default_factory=dict)
    limit: float = LIMIT
    payload: float = 0.0

    def scaled(self, name: str, ratio: float) -> Self:
        """Return it with an attribute of joint or actuator times a ratio."""
        numbers = {k: ratio * v if k == name else v for k, v in self.numbers.items()}
        servo = {k: ratio * v if k == name else v for k, v in self.servo.items()}
        return replace(self, numbers=numbers, servo=servo)


def described(rng: np.random.Generator) -> list[ServoJoint]:
    """Draw an arm."""
    count = int(rng.integers(3, 6))
    size = float(rng.uniform(0.8, 1.3))
    joints = []
    for k in range(count):
        length = size * float(rng.uniform(0.08, 0.2))
        mass = size**3 * float(rng.uniform(0.25, 0.5)) * 0.8**k
        slender = mass * length**2 / 10
        numbers = {
            "armature": float(rng.uniform(0.015, 0.03)),
            "damping": 0.05,
            "frictionloss": 0.04,
        }
        servo = {"kp": float(rng.uniform(15, 25)), "kv": float(rng.uniform(0.4, 0.8))}
        com = (0.0, 0.05 * length, 0.5 * length)
        joints.append(
            ServoJoint(length, mass, com, (slender, slender, 0.2 * slender), numbers, servo)
        )
    return joints


def ordinary(joints: list[ServoJoint], rng: np.random.Generator) -> list[ServoJoint]:
    """Return an arm as it is built after a description."""

    def off(share: float) -> float:
        return float(np.clip(1.0 + share * rng.normal(), 0.5, 1.5))

    built = []
    for one in joints:
        shift = 0.003 * rng.normal(size=3)
        moments = off(0.08)
        friction = off(0.2)
        gain = off(0.1)
        ratios = {
            "armature": off(0.06),
            "damping": friction,
            "frictionloss": friction,
            "kp": gain,
            "kv": gain,
        }
        for name, ratio in ratios.items():
            one = one.scaled(name, ratio)
        com = tuple(float(c + s) for c, s in zip(one.com, shift, strict=True))
        built.append(
            replace(
                one,
                mass=off(0.06) * one.mass,
                com=com,
                moments=tuple(moments * m for m in one.moments),
            )
        )
    return built


def with_effect(
    joints: list[ServoJoint], effect: str, peaks: Array, rng: np.random.Generator
) -> tuple[list[ServoJoint], Fault]:
    """Return an arm with one thing that its description lacks, and that.

    peaks: (n,) largest torques of the motion, Nm.
    """
    k = int(rng.integers(1, len(joints)))
    u = float(rng.uniform())
    own = joints[k]
    numbers = joints[k].numbers
    parameters = dict[str, float]()
    if effect == "coulomb_friction":
        parameters = {"torque": numbers["frictionloss"] + 0.1 + 0.15 * u}
        changed = replace(own, numbers={**numbers, "frictionloss": parameters["torque"]})
    elif effect == "viscous_friction":
        parameters = {"coefficient": numbers["damping"] + 0.3 + 0.4 * u}
        changed = replace(own, numbers={**numbers, "damping": parameters["coefficient"]})
    elif effect == "payload":
        k = len(joints) - 1
        parameters = {"mass": (0.6 + 0.6 * u) * joints[k].mass}
        changed = replace(joints[k], payload=parameters["mass"])
    elif effect in ("position_gain", "velocity_gain"):
        changed = own.scaled("kp" if effect == "position_gain" else "kv", 1.8 + 0.7 * u)
    elif effect == "command_delay":
        late = {"delay": 0.015 + 0.03 * u}
        return [replace(one, servo={**one.servo, **late}) for one in joints], Fault(
            effect, None, late
        )
    elif effect == "torque_saturation":
        parameters = {"torque": float((0.55 + 0.25 * u) * peaks[k])}
        changed = replace(own, limit=parameters["torque"])
    elif effect == "position_dead_band":
        parameters = {"half_width": 0.01 + 0.02 * u}
        changed = replace(own, beside={"dead_band": parameters["half_width"]})
    elif effect == "integral_gain":
        parameters = {"ki": (0.5 + u) * own.servo["kp"]}
        changed = replace(own, beside=parameters)
    elif effect == "rotor_inertia_mismatch":
        changed = own.scaled("armature", 2.0 + u)
    elif effect == "joint_spring":
        changed = replace(own, numbers={**numbers, "stiffness": 1.0 + u, "springref": 0.3})
    else:  # a dress pack pulls beyond its slack
        slack = f"{-1.5 - u:.9g} {0.3 + 0.4 * u:.9g}"
        changed = replace(
            own, numbers={**numbers, "limited": "true", "range": slack, "solreflimit": "-8 -0.2"}
        )
    placed = [changed if j == k else one for j, one in enumerate(joints)]
    return placed, Fault(effect, k, parameters)


def mjcf(joints: list[ServoJoint], step: float) -> str:
    """Return an arm as MJCF."""

    def written(attributes: dict[str, Any]) -> str:
        return " ".join(
            f'{k}="{v if isinstance(v, str) else format(v, ".9g")}"' for k, v in attributes.items()
        )

    bodies = ""
    place = "0 0 0"
    for k, one in enumerate(joints):
        com = " ".join(f"{v:.9g}" for v in one.com)
        moments = " ".join(f"{v:.9g}" for v in one.moments)
        bodies += (
            f'<body name="link_{k + 1}" pos="{place}"><joint name="joint_{k + 1}" axis="{AXES[k]}" '
        )
        bodies += (
            f'{written(one.numbers)}/><inertial pos="{com}" mass="{one.mass:.9g}"'
            f' diaginertia="{moments}"/>'
        )
        if one.payload:
            inertial = (
                f'<inertial pos="0 0 0" mass="{one.payload:.9g}" diaginertia="1e-6 1e-6 1e-6"/>'
            )
            bodies += f'<body name="payload" pos="0 0 {one.length:.9g}">{inertial}</body>'
        place = f"0 0 {one.length:.9g}"
    servos = ""
    for k, one in enumerate(joints):
        history = (
            {"nsample": int(np.ceil(one.servo["delay"] / step)) + 2} if "delay" in one.servo else {}
        )
        limits = f'forcerange="-{one.limit:.9g} {one.limit:.9g}"'
        servos += f'<position joint="joint_{k + 1}" {written({**one.servo, **history})} {limits}/>'
    return (
        f'<mujoco model="servo_arm"><compiler angle="radian"/><option timestep="{step:.12g}"'
        ' integrator="RK4"/>'
        f'<default><joint solreffriction="0.002 1"/></default><worldbody><body name="base">{bodies}'
        f"{'</body>' * len(joints)}</body></worldbody><actuator>{servos}</actuator></mujoco>"
    )


def opened(joints: list[ServoJoint], path: Path, step: float) -> MjcfArm:
    """Return an arm in MuJoCo, by way of a file; with what no actuator of MuJoCo has."""
    path.write_text(mjcf(joints, step))
    arm = open_mjcf(path)
    robot = arm.robot
    for one, joint in zip(joints, robot.joints, strict=True):
        assert joint.controller is not None
        robot = robot.with_joint(joint.name, controller=replace(joint.controller, **one.beside))
    return replace(arm, robot=robot)


def commands(rate: float, seconds: float, n: int, rng: np.random.Generator) -> Array:
    """Return commands (N, n) rad of several frequencies, from rest."""
    t = np.arange(round(seconds * rate)) / rate
    size = rng.normal(size=(6, n)) / (0.6 + MOTION_HZ)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (6, n))
    motion = np.einsum(
        "fj,ftj->tj",
        size,
        np.sin(2 * np.pi * MOTION_HZ[:, None, None] * t[:, None] + phase[:, None]),
    )
    start = np.clip(t, 0.0, 1.0)[:, None]
    middle = np.array([0.0, 0.5, 0.7, 0.0, 0.5, 0.0])[:n]
    return middle + 0.5 * motion / motion.std(axis=0) * start**2 * (3.0 - 2.0 * start)


@dataclass(frozen=True)
class ServoArm:
    """A servo arm as described and as it is, and the commands that it is to follow."""

    stated: list[ServoJoint]
    true: list[ServoJoint]
    faults: list[Fault]
    commands: list[Array]  # (N, n) rad each, at `rate`
    rate: float  # Hz
    step: float  # s, of MuJoCo


def drawn(folder: Path, request: Request, level: Level) -> ServoArm:
    """Draw a servo arm with the effects that are asked for.

    folder: where a file of the model is kept meanwhile, by which MuJoCo takes it.
    """
    rng = np.random.default_rng(request.seed)
    rate = float(rng.choice(level.rates))
    step = 1.0 / rate / np.ceil(1.0 / (rate * STEP))
    stated = described(rng)
    true = ordinary(stated, rng)
    faults = list[Fault]()
    told = [commands(rate, seconds, len(true), rng) for seconds in request.seconds]
    folder.mkdir(parents=True, exist_ok=True)
    plain = record_commands(opened(true, folder / f"{request.name}.xml", step), told[0], rate=rate)
    assert plain.link is not None and plain.link.position is not None
    q = plain.link.position
    kp = np.array([one.servo["kp"] for one in true])
    kv = np.array([one.servo["kv"] for one in true])
    peaks = np.abs(kp * (told[0] - q) - kv * np.gradient(q, 1.0 / rate, axis=0)).max(axis=0)
    for effect in request.effects:
        true, fault = with_effect(true, effect, peaks, rng)
        faults.append(fault)
    return ServoArm(stated, true, faults, told, rate, step)


def record_servos(folder: Path, request: Request, level: Level) -> dict[str, Any]:
    """Draw a servo arm and record it into the folder of a challenge, with its description; return
    its truth."""
    robots = folder / "robots"
    one = drawn(robots, request, level)
    robot = robots / f"{request.name}.xml"
    arm = opened(one.true, robot, one.step)
    for bag, given in zip(bags_of(folder, request.name), one.commands, strict=True):
        if not (bag / "metadata.yaml").is_file():
            write_recording(bag, record_commands(arm, given, rate=one.rate, bits=level.bits))
    robot.write_text(mjcf(one.stated, one.step))
    plain_faults = [asdict(fault) for fault in one.faults]
    faults = one.faults
    return {
        "name": request.name,
        "model": "mod3",
        "level": level.name,
        "joints": list(arm.robot.joint_names),
        "faults": [fault for fault in plain_faults if fault["effect"] not in FOREIGN],
        "foreign": [fault for fault in plain_faults if fault["effect"] in FOREIGN],
        **{key: [] for key in ("ordinary", "conditions", "numbers")},
        "sensors": {"sides": "commands"},
        "multiple": [MODEL_DISTANCE] * len(faults),
        "bound": [None] * len(faults),
        "share": [1.0 / max(1, len(faults))] * len(faults),
        "visible": True,
    }
