"""Columns of uncertain numbers: changes of the residuals by one prior standard deviation of each.

A measured torque has the coefficient one in its equation. The column of a factor on a torque (the
gain of a sensor, a stiffness) therefore contains the torque that the model predicts. With the
measured torque instead, zero gains and a massless arm would explain every recording.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.equations.numbers import GAINS, SCALE, Number
from elastic_arm.equations.places import scaling
from elastic_arm.equations.robot_at import calibrated_robot
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.motion import CompletedMotion, drive_constants, rates_of
from elastic_arm.estimation.noise import wiener_filter
from elastic_arm.estimation.regressors import Entries
from elastic_arm.estimation.residuals import predicted_torques
from elastic_arm.estimation.whitening import NoiseModel, Part, WhitenedData
from elastic_arm.robot import Robot

STEP = 1e-4  # of a prior's standard deviation, for derivatives of Psi; numerical
BLOCK = 512  # samples of the regressor that are evaluated at once: what the caches hold
MOST = 2.5e8  # bytes of columns at the recording's rate that are made at once


def number_columns(
    model: Model,
    nominal: Robot,
    data: WhitenedData,
    parameters: Sequence[Number],
    inertial: Sequence[Array],
    features: Mapping[int, Feature],
    recordings: Sequence[int] = (),
) -> list[Array]:
    """Return columns (N', R, k) of each stretch, Nm for one standard deviation of each prior.

    nominal: the description, to which relative changes refer; recordings: number of each of the
    data's recordings; those of zeros that are others in each act on its own alone.
    """
    result = [columns.copy(order="K") for columns in inertial]
    for k, feature in features.items():
        parameter = parameters[k]
        shown = data.plain(feature)
        for out, columns in zip(result, shown, strict=True):
            out[:, :, k] = columns[:, :, 0] * parameter.prior_std
        if feature.read_torque != "tau_J" or not parameter.is_torque_gain:
            continue
        if "drive" in data.layout.sides:
            # As of the stiffness, so that one scale of all torques still changes nothing.
            for out, part in zip(result, data.parts, strict=True):
                j = model.robot.joint_names.index(str(parameter.joint))
                noise = _in_row(data, part, model.n + j, _load_noise(part)[:, j])
                out[:, :, k] -= noise * parameter.prior_std / part.gain(feature)
        for effect in (
            e for e in data.acting if e.feature.effect.twist and e.feature.joint == parameter.joint
        ):
            for out, part in zip(result, data.parts, strict=True):
                out[:, :, k] -= (
                    _transmitted(feature.equations, data, part, effect) * parameter.prior_std
                )
    others = [k for k, p in enumerate(parameters) if p.feature is None and not p.is_inertial]
    for out, part in zip(result, data.parts, strict=True):
        sensed = "drive" in data.layout.sides
        entries = _drive_entries(
            model, nominal, part, [parameters[k] for k in others], data.acting, sensed=sensed
        )
        out[:, :, others] = data.in_band(part, entries)
    # The same column in one recording alone.
    common = {
        p.feature.key: k
        for k, p in enumerate(parameters)
        if p.feature is not None and p.recording is None
    }
    for k, parameter in enumerate(parameters):
        if parameter.feature is not None and parameter.recording is not None:
            same = common[parameter.feature.key]
            wider = parameters[same].prior_std / parameter.prior_std
            for out, part in zip(result, data.parts, strict=True):
                if recordings[part.recording] == parameter.recording:
                    out[:, :, k] = out[:, :, same] / wider
    return data.weighted(result, in_place=True)


def shared_columns(
    data: WhitenedData,
    parameters: Sequence[Number],
    features: Mapping[int, Feature],
    which: int,
) -> tuple[list[int], list[Array]]:
    """Return what an effect that acts adds to the columns of gains: which gains, and (N', R, m) of
    each stretch.

    A gain scales what the effect adds to the torque. Where the effect is not there, neither is
    this.

    data: whitened residuals, in whose predicted torques it acts; parameters, features: the numbers,
    and the effects that some of them are, as of :func:`features_at`.
    """
    effect = data.acting[which]
    found = [list[Array]() for _ in data.parts]
    numbers = list[int]()
    for k, feature in features.items():
        parameter = parameters[k]
        j = feature.equations.robot.joint_names.index(str(parameter.joint))
        own = (
            ["tau_J", "tau_m"].index(str(feature.read_torque)) if parameter.is_torque_gain else None
        )
        if own is None or not any(part.shares[which][own][:, j].any() for part in data.parts):
            continue
        numbers.append(k)
        for out, part in zip(found, data.parts, strict=True):
            shown = dict(zip(("tau_J", "tau_m"), part.shares[which], strict=True))
            signals = replace(part.signals, values={**part.signals.values, **shown})
            column = data.in_band(part, feature.entries(signals))[:, :, 0] / part.gain(feature)
            if feature.read_torque == "tau_J" and effect.feature.effect.twist:
                column = column - _transmitted(feature.equations, data, part, effect)
            out.append(column * parameter.prior_std)
    joints = effect.feature.equations.robot.joint_names
    for k, parameter in enumerate(() if effect.feature.fixed else parameters):
        j = joints.index(parameter.joint)
        if parameter.what != SCALE or not any(
            part.shares[which][1][:, j].any() for part in data.parts
        ):
            continue
        numbers.append(k)
        for out, part in zip(found, data.parts, strict=True):
            scaled = -parameter.prior_std * part.shares[which][1][:, j]
            out.append(_in_row(data, part, 2 * len(joints) + j, scaled))
    return numbers, data.weighted(
        [np.stack(own, axis=2) for own in found], in_place=True
    ) if numbers else []


def _transmitted(
    equations: ArmEquations, data: WhitenedData, part: Part, effect: ActingEffect
) -> Array:
    """Return what a transmission error makes of the read joint torque at the motor (N', R), Nm.

    It scales with that torque. Without it a recording would seem to show the common scale of all
    torques and masses.
    """
    j = equations.robot.joint_names.index(str(effect.feature.joint))
    n = equations.robot.n
    link, motor, *_ = effect.torques(part.signals)
    return _in_row(data, part, 2 * n + j, (motor - link)[:, j])


def _in_row(data: WhitenedData, part: Part, row: int, values: Array) -> Array:
    """Return what a torque (N,) in one of the full rows adds to the usable ones in the band (N',
    R), Nm."""
    entries = Entries(values[:, None], np.array([row]), np.array([0]), (3 * data.layout.n, 1))
    return data.in_band(part, entries)[:, :, 0]


def features_at(
    model: Model, parameters: Sequence[Number], acting: Sequence[ActingEffect] = ()
) -> dict[int, Feature]:
    """Return the effects that uncertain numbers are, by place in the list; each compiled once for
    all data.

    model: at the present values of the arm's numbers: a wrong zero of an encoder is wound by the
    stiffness where it is; acting: known effects: the friction that changes with temperature is
    among them.
    """
    equations = ArmEquations(model.robot, model.name)
    return {
        k: scaling(parameter.feature.at(equations), acting)
        for k, parameter in enumerate(parameters)
        if parameter.feature is not None and parameter.recording is None
    }


def inertial_columns(
    model: Model, data: WhitenedData, parameters: Sequence[Number], directions: Array
) -> list[Array]:
    """Return the columns (N', R, k) of the inertial numbers of each stretch, zero for other
    parameters.

    They are linear in Psi and depend on the motion alone.

    directions: (P, k) of :func:`directions_of`.
    """
    chosen = [k for k, parameter in enumerate(parameters) if parameter.is_inertial]
    found = []
    for part in data.parts:
        motion = part.stretch.quiet
        # Each column stands in memory as a whole: others are put beside it, and it is transformed.
        out = np.zeros((len(parameters), data.layout.rows, len(part.stretch.t))).T
        count = max(1, int(MOST / (3 * model.n * len(motion) * 8)))
        for first in range(0, len(chosen), count):
            some = chosen[first : first + count]
            out[:, :, some] = data.in_band(part, _regressor(model, motion, directions[:, some]))
        found.append(out)
    return found


def calibrated_parameters(model: Model, nominal: Robot, values: Array, directions: Array) -> Array:
    """Return Psi (P,) with inertial numbers at these values, linear in them whether or not bodies
    are physical.

    nominal: the description, to which relative changes refer; values: (k,) deviations from the
    description, in units of the priors' standard deviations; directions: (P, k) of
    :func:`directions_of`.
    """
    moved = build_model(nominal, model.name).Psi + directions @ values
    springs = _springs(model)
    moved[springs] = model.Psi[springs]
    return np.asarray(moved)


def _springs(model: Model) -> list[int]:
    """Return the numbers of stiffnesses and dampings in Psi."""
    return [
        index for spring in model.bodies.springs for index in (spring.stiffness, spring.damping)
    ]


def _regressor(model: Model, motion: CompletedMotion, directions: Array) -> Array:
    """Columns (N, 3 n, k) of directions (P, k) of Psi."""
    n = model.n
    N = len(motion)
    elastic = model.robot.elastic
    along = directions.copy()
    along[_springs(model)] = 0.0
    spins = [spin.parameter for spin in model.bodies.spins]
    columns = np.zeros((N, 3 * n, along.shape[1]))
    x = motion.coordinates("", elastic=elastic)
    dx = motion.coordinates("d", elastic=elastic)
    ddx = motion.coordinates("dd", elastic=elastic)
    memory = np.empty((min(N, BLOCK), (2 if elastic else 1) * n, len(along)))
    for first in range(0, N, BLOCK):
        part = slice(first, first + BLOCK)
        Phi = model.regressor(x[part], dx[part], ddx[part], out=memory[: min(BLOCK, N - first)])
        rows = (Phi.reshape(-1, len(along)) @ along).reshape(*Phi.shape[:2], -1)
        if elastic:
            columns[part, :n] = rows[:, :n]
            columns[part, 2 * n :] = rows[:, n : 2 * n]
        else:
            # The armature stands in the motor's row, as in the residuals.
            motor = Phi[:, :, spins] @ along[spins]
            columns[part, :n] = rows - motor
            columns[part, 2 * n :] = motor
    return columns


def _drive_entries(
    model: Model,
    nominal: Robot,
    part: Part,
    parameters: Sequence[Number],
    acting: Sequence[ActingEffect],
    *,
    sensed: bool = True,
) -> Entries:
    """Columns (N, 3 n, k): stiffness by predicted torque, damping by that of the spring, presliding
    by speed."""
    n = model.n
    elastic = model.robot.elastic
    motion = part.stretch.quiet
    signals = part.signals
    K, D = drive_constants(model) if elastic else (np.ones(n), np.zeros(n))
    load = rates = _wound(model, part, acting) if elastic else np.zeros((len(motion), n))
    clear = load - _load_noise(part) if sensed else load
    if elastic and not sensed and any(p.what == "damping" for p in parameters):
        # Without a joint torque sensor the deflection stands for the torque: its noise is in
        # residual and column.
        rates = np.stack(
            [_quiet(rate, part.noise, j) for j, rate in enumerate(rates_of(motion.t, load).T)],
            axis=1,
        )
    elif elastic and any(p.what == "damping" for p in parameters):
        # What is known to act beside the spring, such as hysteresis or play, bends how fast it is
        # wound; and the noise of accelerations counts as of no torque: regressed on it, too, a
        # damping would come out too small.
        others = K * signals.values["wound"] - signals.values["tau_J"]
        others = others - sum(
            effect.torques(signals)[3] for effect in acting if effect.feature.follows_load
        )
        rates = rates_of(motion.t, signals.model_torques["tau_J"] + others)
    found: list[tuple[int, int, Array]] = []
    for k, parameter in enumerate(parameters):
        j = model.robot.joint_names.index(parameter.joint)
        gear = nominal.joints[j].transmission
        if parameter.speeds is not None:
            of_motor = elastic and parameter.side == "motor"
            w = (motion.dtheta if of_motor else motion.dq)[:, j]
            found.append(
                (2 * n + j if of_motor else j, k, _turnover(w, motion.t, parameter.speeds))
            )
        elif parameter.what == "stiffness" and gear is not None:
            found.append((n + j, k, clear[:, j]))
        elif parameter.what == "damping" and gear is not None:
            found.append((n + j, k, D[j] / K[j] * rates[:, j]))
        elif parameter.what in GAINS:
            found.append((2 * n + j, k, _of_gain(model, parameter, part, acting)))
    values = np.empty((len(motion), len(found)))
    for column, (_, k, law) in enumerate(found):
        values[:, column] = law * parameters[k].prior_std
    rows = np.array([one[0] for one in found], dtype=int)
    numbers = np.array([one[1] for one in found], dtype=int)
    return Entries(values, rows, numbers, (3 * n, len(parameters)))


def _of_gain(model: Model, parameter: Number, part: Part, acting: Sequence[ActingEffect]) -> Array:
    """Return how what the controller of a joint makes falls (N,) Nm with the logarithm of a gain.

        torque_scale: tau_m = s [kp (r - q) + kd rate],   d tau_m / d ln s = tau_m
        kd:           tau_m = s [kp (r - q) + g kd rate], d tau_m / d ln g = s g kd rate

    Of a recorded duty u, stall u takes the place of kp (r - q).
    The torque is the predicted one: the angle's own noise is in the made torque, too, and gains of
    zero would explain all of it. What the controller commands beyond its limit does not change.
    Laws without a linear size are left out, as they are of the columns of masses: else they would
    tell the scale that both have.
    """
    motion = part.stretch.quiet
    signals = part.signals
    j = model.robot.joint_names.index(parameter.joint)
    joint = model.robot.joints[j]
    controller = joint.controller
    assert controller is not None
    tau_m = signals.values["tau_m"][:, j]
    fed = signals.values["fed"][:, j]
    dr = signals.values["dr"][:, j]
    tau_m = tau_m - sum(
        share[1][:, j] for e, share in zip(acting, part.shares, strict=True) if e.feature.fixed
    )
    kp, kd, _ = controller.gains
    damped = kd * (controller.follows_rate * dr - motion.dtheta[:, j])
    changed = tau_m - fed if parameter.what == SCALE else damped
    error = signals.values["r"][:, j] - controller.follows_angle * motion.theta[:, j]
    asked = controller.supplied(kp * error) + damped
    limit = joint.most_torque
    is_within = np.abs(asked) < (np.inf if limit is None else limit)
    return np.where(is_within, -changed, 0.0)


def _load_noise(part: Part) -> Array:
    """Return what of the predicted load (N, n) Nm is not far above the noise of accelerations.

    That noise is in the residuals, too: a stiffness beside a law of the load could take it off
    them.
    """
    return part.signals.values["tau_J"] - part.signals.model_torques["clear"]


def _quiet(rate: Array, noise: NoiseModel, j: int) -> Array:
    """Return the rate (N,) of the predicted load of joint j, Nm/s, without what is noise of the
    encoders in it.

    It holds the third derivative of the links' angles. Regressed on its noise too, a damping comes
    out too small.
    """
    assert noise.load is not None
    return wiener_filter(rate, noise.rate, noise.f, (2 * np.pi * noise.f) ** 2 * noise.load[:, j])(
        0.0
    )


def _wound(model: Model, part: Part, acting: Sequence[ActingEffect]) -> Array:
    """Return the torques (N, n) by which the drives are wound, Nm: those of the model, and of
    effects that act.

    They are what gains scale. Of the model alone, gains and stiffnesses that scale alike would
    leave what a payload loads the drives with, and a recording would seem to show the common scale
    of all torques and masses.
    """
    load = predicted_torques(model, part.stretch.quiet)[0]
    for effect in acting:
        joint, _, spring, _ = effect.torques(part.signals)
        # What play takes off the deflection, the stiffness would multiply as well.
        play = any(
            parameter.bounded_by == "deflection" for parameter in effect.feature.effect.parameters
        )
        load = load + (joint if play else spring)
    return load


def _turnover(w: Array, t: Array, speeds: Sequence[float]) -> Array:
    """Return how dry friction of 1 Nm may turn over (N,) beside the sign of a velocity w (N,).

    Between two widths of the sign function; or, of a single width, all of it early or late. Dry
    friction makes the acceleration jump, and the smoothed velocity crosses zero as much later as
    the jump exceeds the acceleration.
    """
    if len(speeds) == 2:
        return np.tanh(w / speeds[1]) - np.tanh(w / speeds[0])
    return np.sign(np.gradient(w, t)) * (1.0 - np.tanh(w / speeds[0]) ** 2)


def directions_of(nominal: Robot, model: str, parameters: Sequence[Number]) -> Array:
    """Return the derivative (P, k) of Psi by the numbers of the arm, for one standard deviation of
    each prior."""
    base = build_model(nominal, model).Psi
    found = np.zeros((len(base), len(parameters)))
    for k, parameter in enumerate(parameters):
        if parameter.feature is None:
            values = np.zeros(len(parameters))
            values[k] = STEP
            found[:, k] = (
                build_model(calibrated_robot(nominal, parameters, values), model).Psi - base
            ) / STEP
    return found
