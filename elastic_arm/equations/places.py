"""Candidates of a search: every effect of a catalogue at every place where it could appear, with
initial values.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import rms
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import Effect, EffectInstance, SensorEffect
from elastic_arm.effects.parameters import Parameter
from elastic_arm.estimation.effect_columns import (
    SENSED,
    Feature,
    OwnRegressor,
    compiled_of,
    has_columns,
)
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.whitening import WhitenedData

# of the median deflection of a joint: what its play may be, with encoders' zeros a little apart;
# convention
WOUND = 1.2


def features(equations: ArmEquations, effects: Sequence[Effect]) -> list[Feature]:
    """Return every effect at every place where it adds something to this model's residuals."""
    found = [
        feature_of(instance, equations)
        for effect in effects
        for instance in effect.candidates(equations.robot)
    ]
    return [feature for feature in found if _possible(feature) and feature.acts]


def _possible(feature: Feature) -> bool:
    """Whether the arm has what the effect acts in: without transmissions there is no drive."""
    if feature.equations.robot.elastic:
        return True
    sides = set(feature.sides)
    return ("link" in sides or sides == {"motor"}) and "link_encoder" not in feature.choices.get(
        "channels", ()
    )


def recorded_features(found: Iterable[Feature], motion: Motion) -> list[Feature]:
    """Return the features without those of sensors that were not recorded; of several channels
    those that were.

    motion: of the recordings: its channels, among q, theta, tau_J and tau_m, may be those of some
    joints alone.
    """
    kept: dict[tuple[object, ...], Feature] = {}
    for feature in found:
        joints = feature.equations.robot.joint_names
        recorded = (
            motion.recorded
            if feature.joint is None
            else motion.recorded_at(joints.index(feature.joint))
        )
        if _is_repeated(feature, recorded):
            continue
        if "r" in recorded and isinstance(feature.effect, SensorEffect):
            recorded = recorded - {"tau_m"}  # a torque that was made of commands has no sensor
        shown = {
            name: tuple(channel for channel in chosen if SENSED.get(channel) in recorded)
            for name, chosen in feature.choices.items()
            if isinstance(chosen, tuple) and set(chosen) <= set(SENSED)
        }
        if all(shown.values()):
            only = replace(feature, choices={**feature.choices, **shown}) if shown else feature
            if only.sensed <= recorded:
                kept.setdefault(only.key, only)
    return list(kept.values())


def _is_repeated(feature: Feature, recorded: Collection[str]) -> bool:
    """Whether it is what the same effect on the motor side is: a rigid joint has two sides beside a
    torque sensor."""
    one_side = not feature.equations.robot.elastic and "tau_J" not in recorded
    return one_side and feature.choices.get("side") == "link"


def feature_of(instance: EffectInstance, equations: ArmEquations) -> Feature:
    """Return the feature of an effect on an arm."""
    effect = instance.effect
    chosen = {c.name: instance.parameters[c.name] for c in effect.choices}
    kind = OwnRegressor if effect.regressor is not None and not has_columns(effect) else Feature
    shared = compiled_of(equations.robot, equations.model_name)
    return kind(effect, instance.joint, chosen, equations, shared=shared)


def allowed_values(feature: Feature, parameter: Parameter, data: WhitenedData) -> Parameter:
    """Return a searched parameter with the range that recordings allow.

    Beyond it a law is another one: a drive whose play is wider than it is ever wound transmits no
    torque, a controller of a dead band that holds most errors does not follow, and a drive that
    gives less torque than the motion takes on average would not move so.

    feature, parameter: the effect at its place, and which of its numbers.
    """
    if not parameter.bounded_by or feature.joint is None:
        return parameter
    joint = feature.equations.robot.joint_names.index(feature.joint)
    if parameter.bounded_by == "torque":
        torques = [
            (part.signals.model_torques["tau_m"], part.stretch.quiet.tau_m) for part in data.parts
        ]
        needed, made = (np.concatenate(one)[:, joint] for one in zip(*torques, strict=True))
        low = float(rms(needed, None))
        high = float(np.abs(made).max())
    elif parameter.bounded_by == "error":
        errors = [part.signals.values["r"] - part.stretch.quiet.theta for part in data.parts]
        low = parameter.low
        high = float(np.median(np.abs(np.concatenate(errors)[:, joint])))
    else:  # As the load winds it: what encoders read has their noise.
        wound = np.concatenate([part.signals.values["wound"][:, joint] for part in data.parts])
        low = parameter.low
        high = WOUND * float(np.median(np.abs(wound)))
    low = max(low, parameter.low)
    return replace(
        parameter, low=low, high=max(min(high, parameter.high), low + 1e-6 * (parameter.high - low))
    )


def scaling(feature: Feature, acting: Sequence[ActingEffect]) -> Feature:
    """Return an effect that scales friction with the friction at its place among effects that act;
    others as given."""
    if not feature.effect.scales_friction:
        return feature
    wholes = []
    for effect in acting:
        of = effect.feature
        if not feature.scales(of):
            continue
        values = of.parameters(
            [] if of.fixed else [float(b) for b in effect.coefficients], effect.searched
        )
        flat = [np.atleast_1d(values[p.name]) for p in of.effect.parameters]
        wholes.append((of.whole(), tuple(float(v) for v in np.concatenate(flat))))
    return replace(feature, friction=tuple(wholes))
