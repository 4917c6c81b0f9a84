"""Find fits that leave much more than the noise of the sensors, and decide whether an elastic joint
is the cause.

    residual = tau - Phi Psi,   H = a / (tau - tau(a = 0))

If a joint is rigid, the torque without friction, gravity and the torques of other joints
accelerates one inertia, and H is the same at all frequencies. A joint between two inertias has a
resonance: H has a peak whose half-power points lie inside the band in which the motion has energy,
and up to there half of the acceleration follows the torque. Friction that the equations lack has a
similar effect and is removed first.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.signal import csd, welch

from elastic_arm.arrays import Array, median_step
from elastic_arm.effects.library.friction import DRY
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.law_columns import USUAL_SIGN_SPEED
from elastic_arm.identification.verdict import POORLY, SURE

# Segments of a spectrum, in all; each overlaps the next by half.
SEGMENTS = 8
# Of the largest density of the torque: what is below is no motion; 20 dB.
ENERGY = 1e-2
# Larger ratios of a residual to its sensor's noise are no longer counted: filtered torques hold no
# noise to compare.
COUNTED = 1000


def poor_fits(
    equations: BaseRegression, motion: Motion, Psi_base: Array, noise: Mapping[str, Array]
) -> list[str]:
    """Return in words which torques the fit does not explain. `noise`: channel -> (n,) Nm."""
    measured = equations.measured(motion)
    predicted = equations.predict(motion, Psi_base)
    found = []
    out = equations.left_out(motion)
    for side in equations.sides:
        channel = equations.equations.equation(side).torque
        if channel is None or channel not in noise:
            continue
        for j, joint in enumerate(equations.joints):
            kept = ~out[side][:, j]
            torque = measured[side][kept, j]
            left = torque - predicted[side][kept, j]
            size = noise[channel][j]
            if not torque.any() or np.std(left) <= max(POORLY * np.std(torque), SURE * size):
                continue
            unit = equations.model.robot.units.at(joint, "Nm")
            ratio = float(np.std(left) / max(size, 1e-300))
            times = f"{ratio:.3g}" if ratio < COUNTED else f"more than {COUNTED:g}"
            said = (
                f"{joint}: the residual is {np.std(left):.3g} of {np.std(torque):.3g} {unit}"
                f" (rms), {times} times the "
            )
            said += "noise of its sensor"
            # What exceeds the torque itself is no answer to it.
            possible = not equations.elastic and np.std(left) <= np.std(torque)
            line = resonance(equations, motion, Psi_base, side, j) if possible else None
            said += (
                ""
                if line is None
                else f", with a resonance near {line:.2g} Hz: the joint may be elastic"
            )
            rubs = f"{DRY}:{joint}.torque" in equations.names
            remedy = (
                "the model lacks an effect there"
                if rubs
                else f"also identify its friction (--with {DRY})"
            )
            found.append(f"{said}; {remedy}")
    return found


def resonance(
    equations: BaseRegression, motion: Motion, Psi_base: Array, side: str, joint: int
) -> float | None:
    """Return the frequency, Hz, at which a joint responds most to its torque, or None."""
    still = {}
    acceleration = None
    for name in ("ddq", "ddtheta"):
        values = getattr(motion, name)
        if values is not None:
            acceleration = values[:, joint]
            still[name] = values.copy()
            still[name][:, joint] = 0.0
    if acceleration is None or len(motion) <= SEGMENTS:
        return None
    inertial = equations.measured(motion)[side][:, joint]
    inertial = inertial - equations.predict(replace(motion, **still), Psi_base)[side][:, joint]
    inertial = inertial - _friction(motion, joint, inertial, acceleration)
    given = {
        "fs": 1.0 / median_step(motion.t),
        "nperseg": 2 * len(motion) // (SEGMENTS + 1),
    }
    f, density = welch(inertial, **given)
    answer = np.abs(csd(inertial, acceleration, **given)[1])
    coherence = answer**2 / np.maximum(density * welch(acceleration, **given)[1], 1e-300)
    band = np.flatnonzero(density >= ENERGY * density.max())
    band = np.arange(max(band[0], 1), band[-1] + 1)
    H = answer[band] / np.maximum(density[band], 1e-300)
    if not len(H) or max(H[0], H[-1]) > H.max() / np.sqrt(2.0):
        return None
    upto = np.flatnonzero(H.max() / np.sqrt(2.0) <= H)[-1] + 1
    return float(f[band[np.argmax(H)]]) if np.mean(coherence[band[:upto]]) >= 0.5 else None


def _friction(motion: Motion, joint: int, torque: Array, acceleration: Array) -> Array:
    """Return the part (N,) of a joint's torque that is dry and viscous friction; the remainder is a
    zero and an inertia."""
    rate = next(rates[:, joint] for rates in (motion.dtheta, motion.dq) if rates is not None)
    rubbing = np.column_stack([np.tanh(rate / USUAL_SIGN_SPEED), rate])
    columns = np.column_stack([rubbing, acceleration, np.ones(len(rate))])
    sizes = np.linalg.lstsq(columns, torque, rcond=None)[0]
    return rubbing @ sizes[:2]
