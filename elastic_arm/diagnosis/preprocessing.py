"""Repairs of a recording before its diagnosis: dead torque channels, and clocks that drift apart.

A channel with one constant value was not recorded, whatever its message contains. If two clocks
stamp the two sides of the arm, their drift appears in the twist of the drives: link and motor move
alike except for a deflection that follows the load. A lag that grows with time and is the same on
every joint is therefore a drift of the clocks.
"""

from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array, median_step
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.recording import Recording, Samples, Side
from elastic_arm.recording.inspection.dead_torques import without_dead_torques
from elastic_arm.recording.inspection.outliers import without_outliers
from elastic_arm.recording.inspection.stuck_channels import NO_MOTION, STILL, moves
from elastic_arm.robot import Robot

AVERAGING = 0.02  # s, length of the means on which clocks are compared
SHIFT = 1e-5  # s over the recording; a smaller drift has no measurable effect
CERTAIN = 10.0  # standard deviations of each joint's drift; coloured errors require many
AGREEMENT = 0.2  # relative difference between joints up to which a drift is common to all
PASSES = 3  # iterations of estimating and removing a drift
DIFFERENCE = (
    1e-3  # share of the spread of velocities: they equal differences of positions up to rounding
)
# Fewest means over a recording that show a drift of clocks: several times the number of fitted
# coefficients.
FEWEST_MEANS = 50


def usable(recording: Recording, robot: Robot) -> Recording:
    """Return the recording without outliers and dead torque channels, on one clock, with notes.

    Raises a DiagnosisError if the arm stands still, or every torque channel is dead.
    """
    whole = without_outliers(recording)
    if not moves(whole):
        raise DiagnosisError(f"{recording.source or 'the recording'} contains no motion", NO_MOTION)
    return _one_clock(_without_differences(_live(whole, robot)))


def standing(recording: Recording) -> list[str]:
    """Return the names of the joints that do not move."""
    side = recording.motor or recording.link
    if side is None or side.position is None:
        return []
    return [
        j
        for j, span in zip(recording.joints, np.ptp(side.position, axis=0), strict=True)
        if span < STILL
    ]


def needs_motion(feature: Feature) -> bool:
    """Whether an effect appears only if its joint moves; a drive also winds up at standstill."""
    return feature.effect.needs_motion and "drive" not in feature.sides


def _live(recording: Recording, robot: Robot) -> Recording:
    """Leave out torque channels that are constant."""
    kept, dead = without_dead_torques(recording, robot)
    if dead and all(side.effort is None for side in kept.measured().values()):
        raise DiagnosisError(
            f"every torque channel of {recording.source or 'the recording'} is empty:"
            f" {' and '.join(dead)} hold one number throughout",
            "Record the effort of /motor_states, of /joint_states, or both",
        )
    return kept


def _without_differences(recording: Recording) -> Recording:
    """Leave out velocities that are differences of positions: they add no information, and are half
    a sample late."""
    where = recording.source or "the recording"
    sides: dict[str, Side | None] = {"link": recording.link, "motor": recording.motor}
    found = []
    for name, side in sides.items():
        if side is None or side.position is None or side.velocity is None or len(side) < 3:
            continue
        steps = np.diff(side.stamp_ns)[:, None] * 1e-9
        differences = [np.diff(side.position, axis=0) / step for step in (steps, np.median(steps))]
        errors = [
            np.median(np.abs(velocity - difference), axis=0).max()
            for difference in differences
            for velocity in (side.velocity[1:], side.velocity[:-1])
        ]
        if min(errors) < DIFFERENCE * np.std(side.velocity):
            sides[name] = replace(side, velocity=None)
            found.append(name)
    if not found:
        return recording
    sides_found = " and ".join(found)
    words = f"{where}: {sides_found} velocities are differences of the positions and are not used."
    return replace(
        recording, link=sides["link"], motor=sides["motor"], notes=(*recording.notes, words)
    )


def _one_clock(recording: Recording) -> Recording:
    """Stamp the link side by the clock of the motor side if the two clocks drift apart."""
    link = recording.link
    motor = recording.motor
    if link is None or motor is None or link.position is None or motor.position is None:
        return recording
    total = clock_drift(recording.samples())
    if total is None:
        return recording
    mended = _restamped(recording, link, total)
    for _ in range(PASSES - 1):
        # Once a drift is certain, its remainder is removed, however small.
        drifts = _drifts(mended.samples())
        total += 0.0 if drifts is None else _mean(*drifts)
        mended = _restamped(recording, link, total)
    note = (
        f"{recording.source or 'the recording'}: the clocks of link and motor side drift apart"
        f" by {1e6 * total:.3g} us per second,"
        f" {1e3 * abs(total) * recording.duration:.3g} ms in total: corrected with the"
        " motion of all joints."
    )
    return replace(mended, notes=(*recording.notes, note))


def _restamped(recording: Recording, link: Side, drift: float) -> Recording:
    """Return the recording with a link-side clock that runs slower by a drift."""
    since = link.stamp_ns - link.stamp_ns[0]
    stamps = link.stamp_ns[0] + np.round(since / (1.0 + drift)).astype(np.int64)
    return replace(recording, link=replace(link, stamp_ns=stamps))


def clock_drift(samples: Samples) -> float | None:
    """Return how much faster the clock of the link side runs than that of the motor side (a ratio
    minus 1); None without a drift."""
    found = _drifts(samples)
    if found is None:
        return None
    drifts, stds = found
    mean = _mean(drifts, stds)
    seconds = float(samples.t[-1] - samples.t[0])
    certain = bool((np.abs(drifts) > CERTAIN * stds).all())
    alike = bool((np.abs(drifts - mean) < AGREEMENT * abs(mean)).all())
    return mean if certain and alike and abs(mean) * seconds > SHIFT else None


def _drifts(samples: Samples) -> tuple[Array, Array] | None:
    """Return the drifts of all joints with their standard deviations; None if no joint can show
    one."""
    if samples.q is None or samples.theta is None:
        return None
    if len(samples) < FEWEST_MEANS * _averaging(samples.t, AVERAGING):
        return None
    moves = np.ptp(samples.theta, axis=0) >= STILL
    moves[[joint for channel, joint in samples.lacking if channel in ("q", "theta")]] = False
    found = [_drift_of(samples, int(j), AVERAGING) for j in np.flatnonzero(moves)]
    if not found:
        return None
    drifts, stds = (np.array(column) for column in zip(*found, strict=True))
    return drifts, stds


def _mean(drifts: Array, stds: Array) -> float:
    return float(np.average(drifts, weights=stds**-2.0))


def _drift_of(samples: Samples, j: int, averaging: float) -> tuple[float, float]:
    """Return the drift of one joint, the part of its lag that grows with time, and its standard
    deviation."""
    assert samples.q is not None and samples.theta is not None
    t = _averaged(samples.t, samples.t, averaging)
    q = _averaged(samples.t, samples.q[:, j], averaging)
    theta = _averaged(samples.t, samples.theta[:, j], averaging)
    torques = [c for c in (samples.tau_J, samples.tau_m) if c is not None][:1]
    loads = [_averaged(samples.t, c[:, j], averaging) for c in torques]
    v = np.gradient(theta, t)
    later = (t - t.mean()) * v
    columns = np.stack(
        [later, v, np.sign(v), np.gradient(v, t), np.ones_like(t), *loads, *(c**3 for c in loads)],
        axis=1,
    )
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    beta, *_ = np.linalg.lstsq(columns / scale, theta - q, rcond=1e-10)
    left = theta - q - columns / scale @ beta
    inverse = np.linalg.pinv((columns / scale).T @ (columns / scale))
    return float(beta[0] / scale[0]), float(np.sqrt(inverse[0, 0] * left.var()) / scale[0]) + 1e-12


def _averaged(t: Array, values: Array, seconds: float) -> Array:
    """Return means over blocks of this length, s."""
    length = _averaging(t, seconds)
    count = len(values) // length
    return values[: count * length].reshape(count, length).mean(axis=1)


def _averaging(t: Array, seconds: float) -> int:
    """Return the number of samples of a mean over this length, s."""
    return max(1, round(seconds / median_step(t))) if len(t) > 1 else 1
