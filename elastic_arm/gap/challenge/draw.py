"""What the hidden arms have: effects, joints and magnitudes drawn from a seed.

Magnitudes are drawn relative to the smallest that theory allows to be detected: the Cramér-Rao bound of the effect's
size on a clean recording of the same kind, with all other numbers known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.gap.band import Band
from elastic_arm.gap.challenge.hidden_arm import Course, HiddenArm
from elastic_arm.gap.challenge.instruments import Instruments, measure
from elastic_arm.gap.challenge.laws import Fault
from elastic_arm.gap.challenge.motion import random_motion
from elastic_arm.gap.evidence import Evidence
from elastic_arm.gap.features import Whole
from elastic_arm.gap.observation import observe, widest_band
from elastic_arm.gap.residuals import Layout
from elastic_arm.gap.tilting import Tilting
from elastic_arm.robot import Robot

# Of each effect: the parameter that is its size, and what is drawn of the others.
SIZE = {
    "viscous_friction": "coefficient",
    "coulomb_friction": "torque",
    "stribeck_friction": "torque",
    "load_dependent_friction": "coefficient",
    "nonlinear_stiffness": "cubic",
    "hysteresis": "torque",
    "backlash": "half_gap",
    "transmission_error": "amplitude",
    "torque_ripple": "amplitude",
    "bearing_compliance": "stiffness_scale",
    "payload": "mass",
    "base_tilt": "x",
    "motor_torque_gain": "gain",
    "joint_torque_gain": "gain",
    "motor_torque_offset": "offset",
    "joint_torque_offset": "offset",
    "encoder_offset": "offset",
    "encoder_eccentricity": "amplitude",
    "time_delay": "delay",
    "link_inertia_mismatch": "mass",
    "rotor_inertia_mismatch": "inertia",
    "stiffness_mismatch": "stiffness",
    "damping_mismatch": "damping",
}
SIDED = ("viscous_friction", "coulomb_friction", "stribeck_friction")
WHOLE_ARM = ("payload", "base_tilt", "bearing_compliance", "spline_inertia", "inertia_coupling")
SIGNED = ("gain", "offset", "inertia", "stiffness", "damping", "mass")
CHANNELS = ("joint_torque", "motor_torque", "link_encoder")
LOWEST, HIGHEST = 10.0, 300.0  # bounds
SHORTEST_DELAY = 1.5e-3  # s: a lag of one sample or less is no cause


@dataclass(frozen=True)
class Item:
    """One hidden arm: what is to be recorded.

    Parameters
    ----------
    name
        Of its bags.
    model
        That it will be diagnosed against.
    faults
        What it has; none for a clean arm.
    instruments
        Its sensors.
    seed
        Of motions and noise.
    multiple
        Size of each fault over its bound; None where it has no size.
    withheld
        Effects that the diagnosis must do without.
    """

    name: str
    model: str
    faults: tuple[Fault, ...]
    instruments: Instruments
    seed: int
    multiple: tuple[float | None, ...] = ()
    withheld: tuple[str, ...] = ()

    def truth(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


class Bounds:
    """Smallest sizes that a recording can show, from clean recordings of the hidden arm."""

    def __init__(self, robot: Robot, rng: np.random.Generator, seconds: float) -> None:
        self._robot = robot
        self._course = HiddenArm(robot).run(random_motion(rng, robot.n, seconds))
        self._rng = rng
        self._evidence: dict[int, Evidence] = {}
        self._equations = ArmEquations(robot, "mod3")

    def of(self, fault: Fault, instruments: Instruments) -> float:
        """Return the Cramér-Rao bound of a fault's size, around the parameters it has."""
        evidence = self._clean(instruments)
        effect, size = EFFECTS[fault.effect], SIZE[fault.effect]
        joint = None if fault.joint is None else self._robot.joint_names[fault.joint]
        if fault.effect == "payload":
            joint = self._robot.joint_names[-1]
        feature = Whole(effect, joint, _choices(fault), self._equations)
        values = contract_parameters(fault)
        neutral = effect.parameter(size).neutral or 0.0
        sizes = (neutral, neutral + 1e-3 * (values[size] - neutral))
        columns = []
        for value in sizes:
            given = {p.name: p.neutral or p.default or 0.0 for p in effect.parameters} | {**values, size: value}
            numbers = [np.resize(np.asarray(given[p.name], dtype=float), p.size) for p in effect.parameters]
            columns.append(evidence.whiten(evidence.plain(feature, tuple(np.concatenate(numbers)))))
        return float(abs(sizes[1] - sizes[0]) / max(np.linalg.norm(columns[1] - columns[0]), 1e-300))

    def of_bearings(self, scale: float, instruments: Instruments) -> float:
        """Return how many standard deviations the tilts of bearings so stiff stand out of the noise."""
        evidence = self._clean(instruments)
        feature = Tilting(EFFECTS["bearing_compliance"], None, {}, self._equations)
        return float(np.linalg.norm(evidence.whiten(evidence.plain(feature, (scale,)))))

    def _clean(self, instruments: Instruments) -> Evidence:
        # Encoders within a factor of two of each other are as good as equal here.
        kind = round(np.log2(instruments.encoder_noise)) if instruments.encoder_noise > 0 else 0
        if kind not in self._evidence:
            self._evidence[kind] = self._measured(self._course, instruments)
        return self._evidence[kind]

    def _measured(self, course: Course, instruments: Instruments) -> Evidence:
        recording = measure(course, self._robot.joint_names, (), instruments, self._rng)
        observation = observe(recording)
        model = build_model(self._robot)
        layout = Layout.of(observation.pieces[0], self._robot.n)
        return Evidence(model, [observation], layout, Band(widest_band(observation.rate), observation.rate))


def contract_parameters(fault: Fault) -> dict[str, Any]:
    """Return a fault's parameters by the contract's names, positions as vectors."""
    values: dict[str, Any] = {k: v for k, v in fault.parameters.items() if not k.startswith("position_")}
    if "position_x" in fault.parameters:
        values["position"] = tuple(fault.parameters[f"position_{axis}"] for axis in "xyz")
    return values


def _choices(fault: Fault) -> dict[str, Any]:
    if fault.effect == "time_delay":
        return {"channels": fault.channels}
    return {"side": fault.side} if any(c.name == "side" for c in EFFECTS[fault.effect].choices) else {}


def draw_item(
    name: str,
    effects: tuple[str, ...],
    robot: Robot,
    bounds: Bounds,
    rng: np.random.Generator,
    *,
    withheld: bool = False,
) -> Item:
    """Draw one hidden arm with these effects, on joints and of sizes that the generator decides."""
    instruments = draw_instruments(rng)
    # Several effects on one arm are of like size, so that none is less than a hundredth of the gap.
    level = 10 ** rng.uniform(np.log10(LOWEST), np.log10(HIGHEST))
    faults: list[Fault] = []
    multiples: list[float | None] = []
    model = "mod3"
    for effect in effects:
        if effect in ("spline_inertia", "inertia_coupling"):
            # The arm has them always; it is the model that lacks them.
            model = "mod1" if effect == "spline_inertia" else "mod2"
            faults.append(Fault(effect, None))
            multiples.append(None)
            continue
        own = level * (10 ** rng.uniform(-0.3, 0.3) if len(effects) > 1 else 1.0)
        fault, multiple = _draw_fault(effect, robot, instruments, bounds, own, rng)
        faults.append(fault)
        multiples.append(multiple)
    seed = int(rng.integers(2**31))
    return Item(name, model, tuple(faults), instruments, seed, tuple(multiples), effects if withheld else ())


def draw_instruments(rng: np.random.Generator) -> Instruments:
    """Draw sensors: half of them with noisy, quantised encoders and jittered stamps."""
    if rng.random() < 0.5:
        return Instruments()
    return Instruments(
        encoder_noise=float(10 ** rng.uniform(-6, -5)),
        encoder_step=float(2 * np.pi / 2 ** rng.integers(20, 24)),
        jitter=float(rng.choice([0.0, 2e-5])),
    )


def _draw_fault(
    effect: str,
    robot: Robot,
    instruments: Instruments,
    bounds: Bounds,
    level: float,
    rng: np.random.Generator,
) -> tuple[Fault, float | None]:
    joint = None if effect in WHOLE_ARM else int(rng.integers(robot.n))
    side = str(rng.choice(["motor", "link"])) if effect in SIDED else "motor"
    channels = (str(rng.choice(CHANNELS)),) if effect == "time_delay" else ()
    size = SIZE[effect]
    if effect == "bearing_compliance":
        fault = Fault(effect, None, {size: float(10 ** rng.uniform(-1.3, 0.0))})
        return fault, bounds.of_bearings(fault.parameters[size], instruments)
    parameter = EFFECTS[effect].parameter(size)
    neutral = parameter.neutral or 0.0
    others = _others(effect, rng)
    sample = neutral + (0.1 if neutral else np.sqrt(abs(parameter.low * parameter.high)) or 0.01)
    probe = Fault(effect, joint, {size: float(sample), **others}, side, channels)
    bound = bounds.of(probe, instruments)
    amount = bound * level
    low, high = _plausible(effect, parameter.low, parameter.high, neutral)
    amount = float(np.clip(amount, low, high))
    sign = rng.choice([-1.0, 1.0]) if size in SIGNED and effect != "payload" else 1.0
    values: dict[str, float] = {size: float(neutral + sign * amount), **others}
    if effect == "base_tilt":
        angle = rng.uniform(-np.pi, np.pi)
        values = {"x": float(amount * np.cos(angle)), "y": float(amount * np.sin(angle))}
    return Fault(effect, joint, values, side, channels), amount / bound


def _plausible(effect: str, low: float, high: float, neutral: float) -> tuple[float, float]:
    if effect == "time_delay":
        return SHORTEST_DELAY, 0.01
    if effect == "nonlinear_stiffness":
        return low, high
    if neutral:
        return 0.0, 0.3
    return (low, high) if low > 0 else (0.0, high)


def _others(effect: str, rng: np.random.Generator) -> dict[str, float]:
    """Draw the parameters that are not the size."""
    phase = {"phase": float(rng.uniform(-np.pi, np.pi))}
    drawn: Mapping[str, dict[str, float]] = {
        "stribeck_friction": {"speed": float(10 ** rng.uniform(-1.7, -0.7))},
        "hysteresis": {"width": float(10 ** rng.uniform(-4.5, -3.5))},
        "transmission_error": {**phase, "order": 2.0},
        "torque_ripple": {**phase, "order": float(rng.choice([1, 2, 3]))},
        "encoder_eccentricity": phase,
        "payload": {f"position_{axis}": float(rng.uniform(-0.15, 0.15)) for axis in "xyz"},
    }
    return drawn.get(effect, {})
