"""The regime in which a residual is large: the simplest quantity that it follows."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import welch

from elastic_arm.arrays import Array, rms
from elastic_arm.estimation.motion import rates_of
from elastic_arm.estimation.regressors import Signals
from elastic_arm.estimation.whitening import WhitenedData

ORDERS = (1, 2, 3, 4)  # harmonics of the angles of rotor and wave generator
SLOW = (0.1, 0.3)  # shares of the typical speed: widths of the two low-speed shapes
MOTION = 3.0  # Hz, above the frequencies of motion: spectral lines are sought from here
START = 1.0  # s that count as the start
WEAK = 0.1  # share of the power below which a regime describes nothing
ALIKE = 0.9  # share of the best regime's power from which a simpler one is named

REGIMES = (
    "always",
    "velocity_reversal",
    "low_speed",
    "high_speed",
    "acceleration",
    "load",
    "position",
    "rotor_angle",
    "wave_generator_angle",
    "frequency",
    "start",
    "drift",
)


def shares(
    data: WhitenedData, values: Sequence[Array], row: int, ratios: tuple[float, float]
) -> dict[str, float]:
    """Return the share of one residual's power that follows each regime.

    values: residuals (N', R) of each stretch, Nm; row: which residual; its joint and side follow
    from the layout.
    """
    n = data.layout.n
    side = data.layout.sides[row // n]
    joint = row % n
    r = np.concatenate([v[:, row] for v in values])
    parts = [bases(part.signals, side, joint, n, ratios) for part in data.parts]
    found = {}
    power = float(np.mean(r**2)) or 1.0
    for regime in parts[0]:
        basis = np.concatenate(
            [part.stretch.in_band(p[regime]) for p, part in zip(parts, data.parts, strict=True)]
        )
        beta = np.linalg.lstsq(basis, r, rcond=1e-8)[0]
        left = float(np.mean((r - basis @ beta) ** 2))
        # A fit with more columns explains more by chance.
        found[regime] = max(0.0, 1.0 - left / power * len(r) / max(1, len(r) - basis.shape[1]))
    rates = [part.stretch.band.kept_rate for part in data.parts]
    longest = max(range(len(values)), key=lambda k: len(values[k]))
    found["start"] = _start_share(values, row, rates[0], START)
    found["frequency"] = _line_share(values[longest][:, row], rates[longest], MOTION)
    return found


def regime(found: dict[str, float]) -> str:
    """Return the regime that describes a residual best; of similar ones, the simplest."""
    best = max(found.values())
    if best < WEAK:
        return "always"
    return next(name for name in REGIMES if found.get(name, 0.0) > ALIKE * best)


def bases(
    signals: Signals, side: str, i: int, n: int, ratios: tuple[float, float]
) -> dict[str, Array]:
    """Return the columns (N, k) that a residual of joint i would follow, by regime.

    They have the rate of the recording. side: "link", or another: decides which velocity and sign
    the residual follows.
    """
    v = signals.values
    # Without transmissions the motor turns with the link.
    motor = n if v["x"].shape[1] > n else 0
    offset = 0 if side == "link" else motor
    w = v["dx"][:, offset + i]
    a = v["ddx"][:, offset + i]
    sign = v["sign_link" if side == "link" else "sign_motor"][:, i]
    theta = v["x"][:, motor + i]
    q = v["x"][:, i]
    load = v["tau_J"][:, i]
    # The rate is that of the load without noise, because differentiation amplifies the noise of
    # the encoders, which is also in the residuals. The load itself is that of the columns of
    # nuisance parameters, so that these take their share.
    rate = signals.once(
        "rates of the clear load", lambda: rates_of(signals.t, signals.model_torques["clear"])
    )[:, i]
    typical = float(rms(w, None)) or 1.0
    found = {
        "always": np.ones((len(w), 1)),
        "velocity_reversal": sign[:, None],
        "low_speed": np.stack([np.exp(-((w / (s * typical)) ** 2)) * sign for s in SLOW], axis=1),
        "high_speed": np.stack([w, w * np.abs(w)], axis=1),
        "acceleration": a[:, None],
        "load": np.stack([load, load**3, rate], axis=1),
        "position": np.stack([np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)], axis=1),
        "drift": np.stack([np.ones(len(w)), signals.t], axis=1),
    }
    if ratios[1] != 1.0:  # without a gear the rotor turns with the joint
        waves = [f(k * ratios[0] * theta) for k in ORDERS for f in (np.sin, np.cos)]
        turns = [f(k * ratios[1] * theta) for k in ORDERS for f in (np.sin, np.cos)]
        found["rotor_angle"] = np.stack(turns, axis=1)
        found["wave_generator_angle"] = np.stack(waves, axis=1)
    return found


def _start_share(values: Sequence[Array], row: int, rate: float, seconds: float) -> float:
    """Return the share of the power in the first seconds beyond their share of the time."""
    first = values[0][:, row]
    count = min(len(first), max(1, int(seconds * rate)))
    total = sum(float(np.sum(v[:, row] ** 2)) for v in values)
    time = count / sum(len(v) for v in values)
    share = float(np.sum(first[:count] ** 2)) / total if total else 0.0
    return max(0.0, (share - time) / (1.0 - time))


def _line_share(r: Array, rate: float, motion: float) -> float:
    """Return the share of the power in the strongest narrow line above `motion`, Hz."""
    f, spectrum = welch(r, rate, nperseg=min(len(r), int(4 * rate)))
    above = f > motion
    if not above.any():
        return 0.0
    peak = int(np.argmax(np.where(above, spectrum, 0.0)))
    return float(spectrum[max(0, peak - 2) : peak + 3].sum() / max(spectrum.sum(), 1e-300))
