"""How far ahead the model can see: motor torque in, angles out, over short horizons.

From many instants of the validation data the arm is put into its measured state, driven by the measured motor torque,
and its angles after 10 to 200 ms are compared with those measured: with the model, and with the causes added. All
starts are integrated at once (classical Runge-Kutta, the system of the simulator). Channels are those that the columns
of effects are made of, smoothed alike, so that a torque and the motion that it makes still belong together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.model import Plant
from elastic_arm.estimation.motion import CompletedMotion, drive_constants
from elastic_arm.sensors import Sensors
from elastic_arm.simulation.assembly import System, assemble
from elastic_arm.simulation.simulator import SIGN_SPEED, sign_speed

Array = NDArray[np.float64]
Place = tuple[str, str]

HORIZONS = (0.01, 0.02, 0.05, 0.1, 0.2)  # s
STARTS = 64
LONGEST_STEP = 1e-3  # s
SHARPEST = 1.0  # rad of the fastest vibration in a step; Runge-Kutta is stable up to 2.8 without damping, less with it
DEFLECTION_STEPS = 12  # of a fixed point that contracts as true over nominal stiffness comes near to one


@dataclass(frozen=True)
class Prediction:
    """Root mean squares, over the starts, of predicted minus measured angles.

    Parameters
    ----------
    horizons
        (H,) s.
    starts
        How many.
    before, after
        (joint, side) -> (H,) rad for "link" (q) and "motor" (theta), with the model and with the causes added.
    reason
        Why there is no prediction, empty where there is one.
    """

    horizons: tuple[float, ...] = HORIZONS
    starts: int = 0
    before: Mapping[Place, tuple[float, ...]] | None = None
    after: Mapping[Place, tuple[float, ...]] | None = None
    reason: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data; `before` and `after` are null where there is no prediction."""
        sizes = {"before": self.before, "after": self.after}
        return {
            "horizons_s": list(self.horizons),
            "starts": self.starts,
            "unit": "rad",
            **{name: None if size is None else _nested(size) for name, size in sizes.items()},
            "reason": self.reason or None,
        }


def _nested(size: Mapping[Place, tuple[float, ...]]) -> dict[str, dict[str, list[float]]]:
    found: dict[str, dict[str, list[float]]] = {}
    for (joint, side), values in size.items():
        found.setdefault(joint, {})[side] = [float(f"{v:.4g}") for v in values]
    return found


def predict(material: DiagnosisContext, causes: Sequence[EffectInstance], starts: int = STARTS) -> Prediction:
    """Measure the short-horizon prediction error on the validation data, without and with the causes.

    Parameters
    ----------
    material
        Of the diagnosis; what counted as part of the model acts in both predictions.
    causes
        What was found.
    starts
        Instants from which is predicted, spread evenly over the validation data.
    """
    if material.model.robot.elastic and "motor" not in material.validate.layout.sides:
        return Prediction(reason="motor torque and motor angle are not both recorded: there is nothing to drive with")
    begins = _begins(material, starts)
    if not any(len(b) for b in begins):
        return Prediction(reason=f"no stretch of the validation data is {HORIZONS[-1]:g} s long")
    first = material.seen[1][0].pieces[0]
    sides = [s for s, recorded in (("link", first.q), ("motor", first.theta)) if recorded is not None]
    if not material.model.robot.elastic:
        sides = sides[:1]
    before = _sizes(material, material.known, begins, sides)
    after = _sizes(material, (*material.known, *causes), begins, sides) if causes else before
    return Prediction(_horizons(1.0 / material.seen[1][0].rate), sum(len(b) for b in begins), before, after)


def _horizons(period: float) -> tuple[float, ...]:
    """Return the horizons that samples so far apart can tell from one another."""
    return tuple(h for h, step in zip(HORIZONS, _steps(period), strict=True) if step)


def _steps(period: float) -> list[int]:
    """Return the number of samples in each horizon; 0 where it has less than one."""
    return [int(h / period + 1e-6) for h in HORIZONS]


def _sizes(
    material: DiagnosisContext,
    acting: Sequence[EffectInstance],
    begins: Sequence[NDArray[np.intp]],
    sides: Sequence[str],
) -> dict[Place, tuple[float, ...]]:
    """Return the errors with these effects acting."""
    motions = [part.stretch.quiet for part in material.validate.parts]
    motored = "motor" in material.validate.layout.sides
    arm = _Arm(material.model, acting, 1.0 / max(o.rate for o in material.seen[1]), motored=motored)
    found = [arm.errors(motion, b) for motion, b in zip(motions, begins, strict=True) if len(b)]
    names = material.model.robot.joint_names
    rms = {side: _rms([f[side] for f in found]) for side in sides}
    return {(joint, side): tuple(rms[side][:, i].tolist()) for i, joint in enumerate(names) for side in sides}


def _begins(material: DiagnosisContext, starts: int) -> list[NDArray[np.intp]]:
    """Return the samples of each stretch from which is predicted."""
    stretches = [part.stretch for part in material.validate.parts]
    spans = [max(0.0, s.t[-1] - s.t[0] - HORIZONS[-1]) for s in stretches]
    total = sum(spans)
    found = []
    for stretch, span in zip(stretches, spans, strict=True):
        count = round(starts * span / total) if total else 0
        instants = stretch.t[0] + span * (np.arange(count) + 0.5) / max(1, count)
        found.append(np.searchsorted(stretch.quiet.t, instants))
    return found


def _rms(errors: Sequence[Array]) -> Array:
    """Root mean square (H, n) of errors (starts, H, n) of all stretches."""
    return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


class _Arm:
    """A model with effects that can be put into many measured states at once and driven from there.

    Parameters
    ----------
    model
        Whose Psi holds, fitted or nominal.
    acting
        The effects, those of sensors among them: their channels are corrected before use.
    period
        s between the samples of the recording.
    motored
        Whether motor torque was recorded.
    """

    def __init__(self, model: Model, acting: Sequence[EffectInstance], period: float, *, motored: bool) -> None:
        plant = Plant(model.robot, Sensors.exact())
        for active in acting:
            plant = active.effect.added_to(plant, active)
        self._equations = ArmEquations(plant.robot, model.name, bearings=plant.bearings)
        self._sensors, self._period, self._motored = plant.sensors, period, motored
        self._substeps = 1
        self._system: System = assemble(self._equations, plant.laws)
        fitted = dict(zip((p.name for p in model.parameters), model.Psi - _nominal(model), strict=True))
        self._Psi = self._equations.nominal + [fitted.get(p.name, 0.0) for p in self._equations.bodies.parameters]
        self._K = drive_constants(model)[0]
        self._rate: ca.Function | None = None
        self._constants = np.zeros(0)

    def errors(self, recorded: CompletedMotion, begins: NDArray[np.intp]) -> dict[str, Array]:
        """Return predicted minus measured angles (starts, H, n) of "link" and "motor"."""
        motion = self._driven(corrected(recorded, self._sensors))
        n, steps = self._system.n, [step for step in _steps(self._period) if step]
        y = self._start(motion, begins)
        torque = 0.5 * (motion.tau_m[:-1] + motion.tau_m[1:])
        found: dict[str, list[Array]] = {"link": [], "motor": []}
        for k in range(1, steps[-1] + 1):
            y = self._advance(y, torque[begins + k - 1])
            if k in steps:
                theta = y[:, n : 2 * n] if self._system.dof > n else y[:, :n]
                found["link"].append(y[:, :n] - motion.q[begins + k])
                found["motor"].append(theta - motion.theta[begins + k])
        return {side: np.stack(values, axis=1) for side, values in found.items()}

    def _driven(self, motion: CompletedMotion) -> CompletedMotion:
        """Return the motion with what drives it; without transmissions a joint torque sensor reads it as well."""
        return motion if self._motored else replace(motion, tau_m=motion.tau_J)

    def _start(self, motion: CompletedMotion, begins: NDArray[np.intp]) -> Array:
        """Return states (starts, 2 dof + states): measured motors, links behind them as far as the torque says."""
        x, dx = self._coordinates(motion)
        self._prepare(len(begins), x[begins[0]], motion.tau_m[begins[0]])
        y = np.hstack([values[begins] for values in (x, dx, self._internal(motion, x, dx))])
        if self._system.dof > self._system.n:
            for _ in range(DEFLECTION_STEPS):
                excess = self._evaluate(y, motion.tau_m[begins])[2] - motion.tau_J[begins]
                y[:, : self._system.n] += excess / self._K
        return y

    def _coordinates(self, motion: CompletedMotion) -> tuple[Array, Array]:
        """Return x, dx (N, dof) along the motion; bearings tilt as far as what presses on them says."""
        if not self._equations.robot.elastic:
            return motion.q, motion.dq
        x, dx, ddx = (
            np.hstack(pair)
            for pair in ((motion.q, motion.theta), (motion.dq, motion.dtheta), (motion.ddq, motion.ddtheta))
        )
        tilts = self._system.dof - x.shape[1]
        if not tilts:
            return x, dx
        whole = build_model(self._equations.robot, self._equations.model_name, bearings=True)
        at, rate, acceleration = (np.pad(v, ((0, 0), (0, tilts))) for v in (x, dx, ddx))
        bearings = [(s.coordinate, s.stiffness) for s in self._equations.bodies.springs if s.against is None]
        stiffness = [index for _, index in sorted(bearings)]
        tilt = -whole.inverse_dynamics(at, rate, acceleration, self._Psi)[:, -tilts:] / self._Psi[stiffness]
        return np.hstack([x, tilt]), np.hstack([dx, CubicSpline(motion.t, tilt)(motion.t, 1)])

    def _internal(self, motion: CompletedMotion, x: Array, dx: Array) -> Array:
        """Return internal states of effects (N, states) along the measured motion; they begin at zero."""
        system = self._system
        if not system.states:
            return np.zeros((len(x), 0))
        given = [ca.SX.sym(f"given_{k}", *system.accelerations.size_in(k)) for k in (2, 0, 1, 3, 4)]
        z, rest = given[0], given[1:]
        rate = system.accelerations(rest[0], rest[1], z, *rest[2:])[1]
        course = ca.Function("step", given, [z + self._period * rate]).mapaccum(len(x) - 1)
        known = [values[:-1].T for values in (x, dx, motion.tau_m)]
        z_later = course(np.zeros(system.states), *known, np.repeat(self._constants[:, :1], len(x) - 1, axis=1))
        return np.vstack([np.zeros((1, system.states)), np.array(z_later).T])

    def _prepare(self, starts: int, x: Array, torque: Array) -> None:
        """Make the equations of all starts one call."""
        system, z = self._system, np.zeros(self._system.states)
        given = (self._Psi, system.acting.numbers(), np.full(2 * system.n, SIGN_SPEED))
        rest = np.zeros_like(x)
        stiffness = np.array(system.stiffness_of_balance(x, rest, z, *given))
        mass = np.array(system.friction(x, rest, z, torque, *given)[1])
        fastest = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness))).max())
        step = min(LONGEST_STEP, SHARPEST / fastest)
        self._substeps = int(np.ceil(self._period / step - 1e-9))
        speed = sign_speed(system, self._Psi, x, z, torque, self._period / self._substeps)
        constants = system.constants(self._Psi, system.acting.numbers(), speed)
        self._constants = np.repeat(np.array(constants).reshape(-1, 1), starts, axis=1)
        self._rate = system.accelerations.map(starts)

    def _evaluate(self, y: Array, torque: Array) -> tuple[Array, Array, Array]:
        """Return accelerations, rates of internal states, and joint torques, starts first."""
        dof = self._system.dof
        parts = (y[:, :dof], y[:, dof : 2 * dof], y[:, 2 * dof :], torque)
        assert self._rate is not None
        ddx, dz, tau_J = self._rate(*(p.T for p in parts), self._constants)
        return np.array(ddx).T, np.array(dz).T, np.array(tau_J).T

    def _advance(self, y: Array, torque: Array) -> Array:
        """Return the states (starts, …) a sample later."""
        dof, h = self._system.dof, self._period / self._substeps

        def rate(at: Array) -> Array:
            ddx, dz, _ = self._evaluate(at, torque)
            return np.hstack([at[:, dof : 2 * dof], ddx, dz])

        for _ in range(self._substeps):
            k1 = rate(y)
            k2 = rate(y + h / 2 * k1)
            k3 = rate(y + h / 2 * k2)
            y = y + h / 6 * (k1 + 2 * (k2 + k3) + rate(y + h * k3))
        return y


def _nominal(model: Model) -> Array:
    return np.array([p.nominal for p in model.parameters])


def corrected(motion: CompletedMotion, sensors: Sensors) -> CompletedMotion:
    """Return what the channels would be without the gains, offsets, eccentricities and delays of these sensors."""
    n = motion.q.shape[1]

    def early(values: Array, delay: Array) -> Array:
        if not delay.any():
            return values
        columns = zip(values.T, delay, strict=True)
        return np.stack([CubicSpline(motion.t, column)(motion.t + late) for column, late in columns], axis=1)

    def torque(values: Array, name: str) -> Array:
        sensor = getattr(sensors, name)
        return early((values - sensor.row("offset", n)) / sensor.row("gain", n), sensor.row("delay", n))

    encoder = sensors.link_encoder
    delay = encoder.row("delay", n)
    amplitude, phase = encoder.row("eccentricity", n), encoder.row("phase", n)
    q = motion.q - encoder.row("offset", n)
    q = q - amplitude * np.sin(q + phase)
    return replace(
        motion,
        q=early(q, delay),
        dq=early(motion.dq / (1.0 + amplitude * np.cos(q + phase)), delay),
        ddq=early(motion.ddq, delay),
        tau_J=torque(motion.tau_J, "joint_torque"),
        tau_m=torque(motion.tau_m, "motor_torque"),
    )
