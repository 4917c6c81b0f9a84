"""The uncertain numbers of an arm and its sensors with their priors, nu ~ N(0, (tau std)²)."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.bodies import TENSOR
from elastic_arm.effects.effect import ControllerEffect
from elastic_arm.equations.numbers import PRESLIDING, SCALE, Number
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.motion import Motion
from elastic_arm.evidence.priors import OFFSET_SHARE, PRESLIDING_SHARE, ZERO_AS_MOUNTED, Priors
from elastic_arm.robot import Joint, Robot

LEAST_SCALE = 1e-9  # smallest root of a sum of squares of torques or accelerations; numerical
# Largest deviations at which the model is linearised; numerical.
LARGEST_SCALE = 3.0  # logarithm of the ratio of a stiffness or damping
LARGEST_RATIO = 0.75  # relative error of a torque channel's gain
# rad/s, width of the sign function of dry friction. Multiples of it: pairs of widths between which
# the sign changes, and a width within which it changes early or late. They span gradual sign
# functions.
TURNING = 2e-3
WIDTHS = ((0.25, 1.0), (1.0, 4.0), (1.0,))

# number, joint -> the effect that reports a far-off number
Errors = dict[tuple[str, str | None], Feature]


def numbers_of(
    robot: Robot,
    features: Iterable[Feature],
    rate: float,
    priors: Priors,
    pieces: Sequence[Motion],
    largest: Array,
    turning: Array | None,
    sides: Sequence[str],
) -> tuple[Number, ...]:
    """Return the uncertain numbers of an arm and of its sensors, with their priors.

    features: effects of sensors and of the arm's numbers at every place; those of sensors without a
    prior in their file are left out; priors: of the arm's numbers, and overrides for sensors;
    pieces: the motion, which gives the scale of undescribed motor inertias; largest: torques of the
    joints (n,), Nm, which bound zeros and presliding; turning: speeds (n,) within which dry
    friction changes its sign, rad/s, None if unknown; sides: of the equations; with only one, the
    change of sign is the same on both sides of a drive.
    """
    features = tuple(features)
    inertias = _motor_inertias(pieces)
    errors: Errors = {}
    for feature in features:
        if number := number_of(feature, robot):
            errors[number, feature.joint] = feature
    found: list[Number] = []
    for j, joint in enumerate(robot.joints):
        found += _of_joint(j, joint, priors, inertias, errors)
        presliding = min(priors.presliding, PRESLIDING_SHARE * float(largest[j]))
        found += _turnovers(joint, 0.0 if turning is None else float(turning[j]), presliding, sides)
    for feature in features:
        if isinstance(feature.effect, ControllerEffect):
            found += _of_controller(feature, number_of(feature, robot), priors, errors)
        found += _of_sensor(feature, robot, rate, priors, largest)
    return tuple(found)


def _of_joint(
    j: int, joint: Joint, priors: Priors, inertias: Array | None, errors: Errors
) -> Iterator[Number]:
    """Yield the numbers of a link, its drive and its motor.

    j: index of the joint; inertias: standard deviations (n,) of undescribed motor inertias; None if
    the motion does not show their scale.
    """
    # what -> unit, standard deviation of the prior, value of the description
    stds = {"link_mass": ("1", priors.mass, 1.0)}
    for axis in "xyz":
        stds[f"link_com_{axis}"] = ("m", priors.centre_of_mass, 0.0)
    for a, b in TENSOR:
        std = priors.inertia if a == b else priors.product_of_inertia
        stds[f"link_inertia_{'xyz'[a]}{'xyz'[b]}"] = ("1", std, 0.0)
    if joint.transmission is not None:
        stds["rotor_inertia"] = ("1", priors.rotor, 1.0)
        stds["spline_inertia_ratio"] = ("1", priors.rotor, 1.0)
        stds["stiffness"] = ("1", priors.stiffness, 1.0)
        stds["damping"] = ("1", priors.damping, 1.0)
    if joint.armature:
        stds["rotor_inertia"] = ("1", priors.rotor, 1.0)
    elif joint.armature is not None and inertias is not None:
        unit = "kg" if joint.prismatic else "kg m^2"
        stds["rotor_inertia"] = (unit, float(inertias[j]), 0.0)
    for what, (unit, std, neutral) in stds.items():
        limit = LARGEST_SCALE / std if what in ("stiffness", "damping") else np.inf
        error = errors.get((what, joint.name)) if neutral == 1.0 else None
        yield Number(what, joint.name, unit, std, neutral, error=error, limit=limit)


def number_of(feature: Feature, robot: Robot) -> str:
    """Return the name of the number of which an effect at its place is an error; empty if there is
    none."""
    effect = feature.effect
    if feature.joint is None or not isinstance(effect, ControllerEffect):
        return effect.number
    return effect.number_at(robot.joints[robot.joint_names.index(feature.joint)])


def _of_controller(
    feature: Feature, number: str, priors: Priors, errors: Errors
) -> Iterator[Number]:
    """Yield the number of a controller's gain, or of its common scale if there is no other."""
    if not number or feature.joint is None:
        return
    what = number if (SCALE, feature.joint) in errors else SCALE
    std = priors.controller if what == SCALE else priors.gain_ratio
    yield Number(what, feature.joint, "1", std, 1.0, error=feature, limit=LARGEST_SCALE / std)


def _of_sensor(
    feature: Feature, robot: Robot, rate: float, priors: Priors, largest: Array
) -> Iterator[Number]:
    """Yield the number of a sensor's effect at a joint, if the effect has a prior."""
    effect = feature.effect
    chosen = _single_choices(feature)
    if effect.prior is None or feature.joint is None or chosen is None:
        return
    parameter = feature.linear[0]
    std = priors.sensors.get(effect.id, effect.prior(rate))
    if parameter.unit == "Nm" and effect.id not in priors.sensors:
        torque = float(largest[robot.joint_names.index(feature.joint)])
        std = min(std, OFFSET_SHARE * torque)
    limit = LARGEST_RATIO / std if parameter.unit == "1" else np.inf
    what = "_".join([effect.id, *chosen])
    neutral = parameter.neutral or 0.0
    yield Number(what, feature.joint, feature.unit(parameter), std, neutral, feature, limit=limit)


def _turnovers(joint: Joint, turning: float, std: float, sides: Sequence[str]) -> Iterator[Number]:
    """Yield the numbers of the sign function of dry friction on each side.

    turning: speed at which dry friction changes its sign, rad/s.
    """
    apart = joint.transmission is not None and {"link", "motor"} <= set(sides)
    width = max(turning, TURNING)
    for side in ("link", "motor") if apart else ("motor",):
        for k, shares in enumerate(WIDTHS):
            speeds = tuple(share * width for share in shares)
            yield Number(
                f"{PRESLIDING}_{side}_{k}",
                joint.name,
                joint.unit("Nm"),
                std,
                0.0,
                speeds=speeds,
                side=side,
            )


def resolved_speeds(pieces: Sequence[Motion], n: int, rate: float) -> Array:
    """Return the changes of velocities within two samples at reversals (n,), rad/s.

    Signals faster than half the rate (samples/s) are not recorded, so the shape of friction below
    these speeds is unknown.
    """
    squares = np.zeros(n)
    count = np.zeros(n)
    for piece in pieces:
        of_motor = piece.ddq is None
        dq, ddq = (piece.dtheta, piece.ddtheta) if of_motor else (piece.dq, piece.ddq)
        if dq is None or ddq is None:
            continue
        reverses = np.signbit(dq[1:]) != np.signbit(dq[:-1])
        squares += np.sum(np.square(ddq[1:]), axis=0, where=reverses)
        count += reverses.sum(axis=0)
    return 2.0 / rate * np.sqrt(squares / np.maximum(count, 1.0))


def _motor_inertias(pieces: Sequence[Motion]) -> Array | None:
    """Return the motor inertias (n,) that would explain all the motor torque, kg m²; None without
    recorded motor torque.

    A description of the links does not indicate the inertia of their motors: with gears it may be
    a hundred times that of a wrist.
    """
    squares: Array = np.zeros((2, 1))
    for piece in pieces:
        ddq = piece.ddq if piece.ddq is not None else piece.ddtheta
        if piece.tau_m is None or ddq is None:
            return None
        squares = squares + np.array(
            [np.nansum(np.square(values), axis=0) for values in (piece.tau_m, ddq)]
        )
    torque, acceleration = np.sqrt(squares)
    return np.maximum(torque, LEAST_SCALE) / np.maximum(acceleration, LEAST_SCALE)


def unreferenced(number: Number, priors: Priors) -> Number:
    """Return the number with its prior on an arm without joint torque sensors: no known torque has
    set the zeros of its encoders.

    priors: with the sensors whose prior the user states, which holds.
    """
    own = number.feature
    zero = number.unit in ("rad", "m")
    if own is None or "q" not in own.sensed or not zero or own.effect.id in priors.sensors:
        return number
    return replace(number, prior_std=max(number.prior_std, ZERO_AS_MOUNTED))


def of_each_recording(numbers: Sequence[Number], count: int, share: float) -> tuple[Number, ...]:
    """Return the differences of the zeros of sensors between each recording and the first.

    count: number of recordings; share: standard deviation over that of the zero itself.
    """
    zeros = [p for p in numbers if p.feature is not None and p.feature.effect.set_at_start]
    apart = [replace(p, what=f"{p.what}_difference", prior_std=share * p.prior_std) for p in zeros]
    return tuple(replace(p, recording=k) for k in range(1, count) for p in apart)


def _single_choices(feature: Feature) -> list[str] | None:
    """Return the choices of an effect; None if any choice has several values."""
    chosen = [
        (value,) if isinstance(value, str) else tuple(value) for value in feature.choices.values()
    ]
    if any(len(values) > 1 for values in chosen):
        return None
    return [values[0] for values in chosen]
