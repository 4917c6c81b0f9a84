"""A single linear drive, integrated by hand: a mass with friction under a servo, as an amplifier's
log holds it."""

from pathlib import Path

import numpy as np
import scipy.io

AXIS = """
name: linear_axis
joints:
  - {name: axis, type: prismatic, dh: {a: 0.0, d: 0.0, alpha: 0.0},
     link: {mass: 80.0, com: [0, 0, 0], inertia: {xx: 1.0, yy: 1.0, zz: 1.0}}}
base: {placement: [[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]}
"""
MAPPING = """
times: {key: t}
joints: [axis]
motor:
  position: {key: position, unit: mm}
  effort: {key: voltage, unit: N, factor: 35.15}
ignore: [gain]
"""
GAIN = 35.15  # N/V
MASS, VISCOUS, COULOMB, OFFSET = 95.0, 203.5, 20.4, -3.1  # kg, N s/m, N, N
RATE, STEPS = 500, 10


def write_axis(folder: Path) -> None:
    """Write the arm file, the mapping and two logs as `.mat` files, `fit.mat` and `judge.mat`."""
    (folder / "axis.yaml").write_text(AXIS)
    (folder / "map.yaml").write_text(MAPPING)
    for seed, name in enumerate(("fit", "judge")):
        scipy.io.savemat(folder / f"{name}.mat", log(np.random.default_rng(seed), 1.0 + 0.7 * seed))


def log(rng: np.random.Generator, pace: float, seconds: float = 12.0) -> dict[str, object]:
    """Return times (s), positions (mm) in steps of 1 µm, and voltages of a servo on a noisy
    amplifier."""
    t = np.arange(int(seconds * RATE)) / RATE
    reference = 0.1 * np.sin(pace * t) * np.tanh(t) + 0.04 * np.sin(3.3 * pace * t)
    positions, voltages = np.empty_like(t), np.empty_like(t)
    q = v = 0.0
    for k, wanted in enumerate(reference):
        positions[k] = np.round(q / 1e-6) * 1e-6
        voltages[k] = 243.0 * (60.0 * (wanted - q) - v) / GAIN
        for _ in range(STEPS):
            friction = VISCOUS * v + COULOMB * np.tanh(v / 1e-4)
            v += (GAIN * voltages[k] - friction - OFFSET) / MASS / RATE / STEPS
            q += v / RATE / STEPS
    # The drive holds its command from each sample to the next: recorded is the mean of the two that
    # a sample bounds.
    recorded = 0.5 * (voltages + np.concatenate([voltages[:1], voltages[:-1]]))
    return {
        "t": t,
        "position": 1e3 * positions,
        "voltage": recorded + rng.normal(0.0, 0.01, len(t)),
        "gain": GAIN,
    }
