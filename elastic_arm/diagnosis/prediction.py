"""Short-horizon prediction error of the angles, without and with the causes.

From many instants of the validation recordings, the model starts in the measured state, is driven
by the measured motor torque, and its angles after 10 to 200 ms are compared with the measured ones.
The channels are smoothed like those of the columns of effects, so that a torque and its motion stay
aligned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Array, Indices, rms
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.dynamics import Model
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import Plant
from elastic_arm.estimation.effect_columns import SENSED
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.estimation.motion import CompletedMotion, drive_constants
from elastic_arm.formatting import JointUnits
from elastic_arm.sensors import Sensors
from elastic_arm.simulation.batch_prediction import BatchPrediction

HORIZONS = (0.01, 0.02, 0.05, 0.1, 0.2)  # s
STARTS = 64
BARE = 1e-12  # inertia of a joint over the largest one, below which it is rounding
# rad, error from which the model counts as diverged.
FARTHEST = 1.0


@dataclass(frozen=True)
class Prediction:
    """Root mean square differences of predicted and measured angles, over the starts."""

    horizons: tuple[float, ...] = HORIZONS  # (H,) s
    starts: int = 0  # number of starts
    # before, after: (joint, side) -> (H,) rad for "link" (q) and "motor" (theta), without and with
    # the causes; NaN if the model diverges from the motion
    before: Mapping[Place, tuple[float, ...]] | None = None
    after: Mapping[Place, tuple[float, ...]] | None = None
    reason: str = ""  # why predictions are missing; empty if none are

    def to_dict(self, unit: str = "rad") -> dict[str, Any]:
        """Return the content of `diagnosis.json`; null where there is no prediction.

        unit: of positions.
        """
        sizes = {"before": self.before, "after": self.after}
        return {
            "horizons_s": list(self.horizons),
            "starts": self.starts,
            "unit": unit,
            **{name: None if size is None else _nested(size) for name, size in sizes.items()},
            "reason": self.reason or None,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Prediction:
        """Return what :meth:`to_dict` wrote."""
        before = None if data["before"] is None else _flat(data["before"])
        after = None if data["after"] is None else _flat(data["after"])
        return Prediction(
            tuple(data["horizons_s"]), data["starts"], before, after, data["reason"] or ""
        )


def _flat(
    nested: Mapping[str, Mapping[str, Sequence[float | None]]],
) -> dict[Place, tuple[float, ...]]:
    found = {}
    for joint, by_side in nested.items():
        for side, row in by_side.items():
            found[joint, side] = tuple(np.nan if v is None else v for v in row)
    return found


def _nested(size: Mapping[Place, tuple[float, ...]]) -> dict[str, dict[str, list[float | None]]]:
    found: dict[str, dict[str, list[float | None]]] = {}
    for (joint, side), values in size.items():
        found.setdefault(joint, {})[side] = [
            float(f"{v:.4g}") if np.isfinite(v) else None for v in values
        ]
    return found


def predict(context: DiagnosisContext, causes: Sequence[EffectInstance]) -> Prediction:
    """Measure the short-horizon prediction error on the validation recordings, without and with
    the causes.

    The known effects of the diagnosis act in both predictions.
    """
    if context.model.robot.elastic and "motor" not in context.validate.layout.sides:
        return Prediction(
            reason=(
                "motor torque and motor angle were not both recorded, so no simulation can be"
                " driven"
            )
        )
    if bare := _undriven(context):
        return Prediction(reason=f"the driving torque of {', '.join(bare)} was not recorded")
    if made := context.seen[0].made_by:
        of_duty = all(own.mode == "duty" for own in made.values())
        instead = (
            "it is computed from the duty" if of_duty else "`elastic-arm replay` uses the commands"
        )
        return Prediction(reason=f"no driving torque was measured; {instead}")
    begins = _begins(context)
    if not any(len(b) for b in begins):
        return Prediction(reason=f"no interval of the validation data is {HORIZONS[-1]:g} s long")
    if light := _without_inertia(context):
        return Prediction(
            reason=(
                f"the model has no inertia at {', '.join(light)}, whose acceleration would be"
                " unbounded"
            )
        )
    first = context.seen[0].pieces[0]
    sides = [
        s for s, recorded in (("link", first.q), ("motor", first.theta)) if recorded is not None
    ]
    if not context.model.robot.elastic:
        sides = sides[:1]
    before = _errors(context, (), causes, begins, sides)
    after = _errors(context, causes, (), begins, sides) if causes else before
    horizons = _horizons(1.0 / context.seen[0].rate)
    units = context.model.robot.units
    reason = _left(before, horizons, "the model", units) or _left(
        after, horizons, "the model with the causes", units
    )
    return Prediction(horizons, sum(len(b) for b in begins), before, after, reason)


def _undriven(context: DiagnosisContext) -> list[str]:
    """Return the joints that lack the driving torque while others have it."""
    channel = "tau_m" if "motor" in context.validate.layout.sides else "tau_J"
    lacking = {
        joint for piece in context.seen[0].pieces for own, joint in piece.lacking if own == channel
    }
    return [context.model.robot.joint_names[joint] for joint in sorted(lacking)]


def _without_inertia(context: DiagnosisContext) -> list[str]:
    """Return the joints without inertia in the model, such as a point mass on the last axis and
    motors without inertia."""
    model = context.model
    if model.robot.elastic:
        return []
    poses = context.validate.parts[0].stretch.quiet.q[:1]
    heaviness = np.diagonal(model.mass_matrix(poses)[0])
    return [
        name
        for name, own in zip(model.robot.joint_names, heaviness, strict=True)
        if own < BARE * heaviness.max()
    ]


def _left(
    size: Mapping[Place, tuple[float, ...]], horizons: Sequence[float], what: str, units: JointUnits
) -> str:
    """Return in words where the model diverges from the motion; empty if nowhere."""
    first = {
        place: int(np.argmax(np.isnan(values)))
        for place, values in size.items()
        if np.isnan(values).any()
    }
    if not first:
        return ""
    (joint, side), k = min(first.items(), key=lambda found: found[1])
    far = f"{FARTHEST:g} {units.at(joint, 'rad')}"
    return (
        f"driven by the measured torque, {what} deviates by more than {far} within"
        f" {1e3 * horizons[k]:g} ms ({joint}, {side}), for example because most of the"
        " torque is friction that the model lacks, or because an inertia is far too small"
    )


def _horizons(period: float) -> tuple[float, ...]:
    """Return the horizons of at least one sample period."""
    return tuple(h for h, step in zip(HORIZONS, _steps(period), strict=True) if step)


def _steps(period: float) -> list[int]:
    """Return the number of samples in each horizon; 0 if it is shorter than a sample."""
    return [int(h / period + 1e-6) for h in HORIZONS]


def _errors(
    context: DiagnosisContext,
    causes: Sequence[EffectInstance],
    lacking: Sequence[EffectInstance],
    begins: Sequence[Indices],
    sides: Sequence[str],
) -> dict[Place, tuple[float, ...]]:
    """Return the root mean square errors with some causes in the plant, after correction of sensor
    effects among them.

    lacking: causes that are not in the plant; their lags and gains, which the calibration removed,
    are added to the channels again.
    """
    # causes replace the same known effects
    own = {(one.effect.id, one.joint) for one in causes}
    known = [one for one in context.known if (one.effect.id, one.joint) not in own]
    plant = _with(Plant(context.model.robot, Sensors.exact()), (*known, *causes))
    taken = taken_out(context, _with(plant, lacking).sensors)
    period = 1.0 / max(o.rate for o in context.seen)
    begin, end = context.validate.parts[0].stretch.quiet.span or (0.0, 1.0)
    predictor = _predictor(context.model, plant, period, end - begin)
    steps = [step for step in _steps(period) if step]
    motored = "motor" in context.validate.layout.sides
    found: dict[str, list[Array]] = {"link": [], "motor": []}
    for part, starts in zip(context.validate.parts, begins, strict=True):
        if not len(starts):
            continue
        motion = corrected(part.stretch.quiet, plant.sensors, taken)
        # Without transmissions, a joint torque sensor measures the driving torque.
        motion = motion if motored else replace(motion, tau_m=motion.tau_J)
        with np.errstate(over="ignore", invalid="ignore"):
            q, theta = predictor.angles(motion, starts, steps)
        ends = starts[:, None] + np.array(steps)
        found["link"].append(q - motion.q[ends])
        found["motor"].append(theta - motion.theta[ends])
    names = context.model.robot.joint_names
    rms = {side: _rms(found[side]) for side in sides}
    return {
        (joint, side): tuple(rms[side][:, i].tolist())
        for i, joint in enumerate(names)
        for side in sides
    }


def _with(plant: Plant, effects: Sequence[EffectInstance]) -> Plant:
    """Return a plant with effects."""
    for instance in effects:
        plant = instance.effect.added_to(plant, instance)
    return plant


def taken_out(context: DiagnosisContext, sensors: Sensors) -> dict[str, tuple[Array, Array]]:
    """Return the gains and lags, (n,) s, that the calibration removed from each channel.

    sensors: with all causes; ordinary gains and lags are not causes and stay removed.
    """
    n = len(context.model.robot.joints)
    found = {}
    for channel in ("joint_torque", "motor_torque", "link_encoder"):
        own = getattr(sensors, channel)
        delayed = own.row("delay", n) != 0.0
        scaled = getattr(own, "gain", 1.0) != np.ones(n)
        gain = context.seen[0].gains.get(SENSED[channel], 1.0)
        late = context.judging.late.get(channel, 0.0)
        found[channel] = np.where(scaled, gain, 1.0), np.where(delayed, late, 0.0)
    return found


def _begins(context: DiagnosisContext) -> list[Indices]:
    """Return the samples of each stretch at which predictions start, evenly spread."""
    stretches = [part.stretch for part in context.validate.parts]
    spans = [max(0.0, s.t[-1] - s.t[0] - HORIZONS[-1]) for s in stretches]
    total = sum(spans)
    found = []
    for stretch, span in zip(stretches, spans, strict=True):
        count = round(STARTS * span / total) if total else 0
        instants = stretch.t[0] + span * (np.arange(count) + 0.5) / max(1, count)
        found.append(np.searchsorted(stretch.quiet.t, instants))
    return found


def _rms(errors: Sequence[Array]) -> Array:
    """Return the root mean square (H, n) of errors (starts, H, n) of all stretches; NaN where the
    model diverged."""
    with np.errstate(over="ignore"):
        size = rms(np.concatenate(errors))
    return np.where(size < FARTHEST, size, np.nan)


def _predictor(model: Model, plant: Plant, period: float, duration: float) -> BatchPrediction:
    """Return the predictor of a plant with the fitted changes of the model's parameters."""
    equations = ArmEquations(plant.robot, model.name, bearings=plant.bearings)
    fitted = dict(zip((p.name for p in model.parameters), model.Psi - _nominal(model), strict=True))
    Psi = equations.nominal + [fitted.get(p.name, 0.0) for p in equations.bodies.parameters]
    return BatchPrediction(equations, plant.laws, Psi, drive_constants(model)[0], period, duration)


def _nominal(model: Model) -> Array:
    return np.array([p.nominal for p in model.parameters])


def corrected(
    motion: CompletedMotion,
    sensors: Sensors,
    taken: Mapping[str, tuple[Array, Array]] | None = None,
) -> CompletedMotion:
    """Return the channels without the gains, offsets, eccentricities and delays of these sensors.

    taken: gains and lags, s, by channel, that were already removed.
    """
    n = motion.q.shape[1]
    taken = taken or {}

    def early(values: Array, delay: Array) -> Array:
        if not delay.any():
            return values
        columns = zip(values.T, delay, strict=True)
        return np.stack(
            [CubicSpline(motion.t, column)(motion.t + late) for column, late in columns], axis=1
        )

    def torque(values: Array, name: str) -> Array:
        sensor = getattr(sensors, name)
        gain, late = taken.get(name, (1.0, 0.0))
        return early(
            (values * gain - sensor.row("offset", n)) / sensor.row("gain", n),
            sensor.row("delay", n) - late,
        )

    encoder = sensors.link_encoder
    delay = encoder.row("delay", n) - taken.get("link_encoder", (1.0, 0.0))[1]
    amplitude = encoder.row("eccentricity", n)
    phase = encoder.row("phase", n)
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
