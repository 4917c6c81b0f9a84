"""`identify` beside a plain base-parameter least squares, on recordings of real arms: held-out rms
of every joint.

The plain fit is what an engineer writes in an hour, with another engine: zero-phase Butterworth
filter at 8 Hz, accelerations by differences, Pinocchio's regressor of the rigid arm, Coulomb and
viscous friction, motor inertia and an offset for every joint, minimum-norm least squares. Both are
judged on the same samples of the recording, below 8 Hz.

    python benchmarks/compare_identification.py ROBOT FIT [FIT ...] --validate BAG [--side link]
    [--cutoff 8]

ROBOT is an arm file or a URDF, FIT and BAG are recordings (`elastic-arm bag import` makes them of
arrays).
"""

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from xml.etree import ElementTree

import numpy as np
import pinocchio
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from elastic_arm.estimation.resampling import Clock, Grid
from elastic_arm.identification import (
    DerivativeStage,
    IdentificationSettings,
    identify_with,
    parse_laws,
)
from elastic_arm.recording import Recording, read_recording
from elastic_arm.robot import Robot, load_robot, to_urdf

Array = NDArray[np.float64]

# Seconds at both ends of a piece that the filter spoils.
ENDS = 0.5
# A velocity below this, rad/s, has no sign to speak of.
STANDSTILL = 1e-2
# Singular values below this share of the largest are taken for zero.
RANK = 1e-6


def filtered(values: Array, rate: float, cutoff: float) -> Array:
    """Pass columns (N, n) through a zero-phase Butterworth filter of order 4, cutoff in Hz."""
    return np.asarray(sosfiltfilt(butter(4, cutoff / (rate / 2), output="sos"), values, axis=0))


@dataclass(frozen=True)
class Errors:
    """What a fit misses of the held-out torques.

    Parameters
    ----------
    t
        (N,) s.
    values
        (N, n) Nm, below the cutoff.
    """

    t: Array
    values: Array

    def within(self, spans: list[tuple[float, float]]) -> Self:
        """Return those of samples within these spans of time."""
        kept = np.any([(first <= self.t) & (self.t <= last) for first, last in spans], axis=0)
        return Errors(self.t[kept], self.values[kept])

    @property
    def rms(self) -> Array:
        """Root of the mean square (n,), Nm."""
        return np.asarray(np.sqrt(np.mean(self.values**2, axis=0)))


def rows(
    model: pinocchio.Model, grid: Grid, cutoff: float, motor_inertia: bool
) -> tuple[Array, Array, Array]:
    """Return the regressor (N, n, P), the torques (N, n) and the times (N,) of one piece.

    Parameters
    ----------
    model
        The rigid arm.
    grid
        Samples at a constant rate.
    cutoff
        Hz.
    motor_inertia
        Whether the torque moves rotors too.
    """
    position = grid.theta if grid.theta is not None else grid.q
    torque = grid.tau_J if grid.tau_J is not None else grid.tau_m
    q = filtered(position, grid.rate, cutoff)
    dq = np.gradient(q, 1 / grid.rate, axis=0)
    ddq = np.gradient(dq, 1 / grid.rate, axis=0)
    data = model.createData()
    inertial = np.array(
        [
            pinocchio.computeJointTorqueRegressor(model, data, *state)
            for state in zip(q, dq, ddq, strict=True)
        ]
    ).reshape(len(q), model.nv, -1)  # of a single joint they are vectors
    own = np.eye(model.nv)
    extra = [
        dq[:, :, None] * own,
        np.tanh(dq / STANDSTILL)[:, :, None] * own,
        np.ones_like(dq)[:, :, None] * own,
    ]
    extra += [ddq[:, :, None] * own] if motor_inertia else []
    phi = np.concatenate([inertial, *extra], axis=2)
    shape = phi.shape
    phi = filtered(phi.reshape(len(phi), -1), grid.rate, cutoff).reshape(shape)
    ends = slice(int(ENDS * grid.rate), -int(ENDS * grid.rate))
    return phi[ends], filtered(torque, grid.rate, cutoff)[ends], grid.t[ends]


def _bounded(urdf: str) -> str:
    """Return the URDF with joints that Pinocchio gives one coordinate each: continuous ones would
    have two."""
    tree = ElementTree.fromstring(urdf)
    for joint in tree.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            if joint.find("limit") is None:
                ElementTree.SubElement(
                    joint, "limit", lower="-7", upper="7", effort="1e6", velocity="100"
                )
    return ElementTree.tostring(tree, encoding="unicode")


def rigid_model(robot: Robot) -> pinocchio.Model:
    """Return the rigid arm of a description, under its gravity."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(_bounded(to_urdf(robot)), encoding="utf-8")
        whole = pinocchio.buildModelFromUrdf(str(path))
    moving = [whole.getJointId(name) for name in robot.joint_names]
    fixed = [k for k in range(1, whole.njoints) if k not in moving]
    model = pinocchio.buildReducedModel(whole, fixed, pinocchio.neutral(whole))
    # A URDF states no gravity: the library's own would be straight down, whatever the arm file has.
    model.gravity.linear = robot.gravity
    return model


def plain(robot: Robot, fits: list[Recording], held_out: Recording, cutoff: float) -> Errors:
    """Return what the plain fit misses of the held-out recording."""
    model = rigid_model(robot)
    parts = []
    for recording in (*fits, held_out):
        samples = recording.select(robot.joint_names).samples()
        grid = max(Clock.of(samples).place(samples), key=len)
        parts.append(rows(model, grid, cutoff, samples.tau_J is None))
    phi, tau, _ = (np.concatenate(some) for some in zip(*parts[:-1], strict=True))
    phi = phi.reshape(-1, phi.shape[-1])
    tau = tau.ravel()
    scale = np.maximum(np.linalg.norm(phi, axis=0), 1e-12)
    solution = np.linalg.lstsq(phi / scale, tau, rcond=RANK)[0] / scale
    phi, tau, t = parts[-1]
    return Errors(t, tau - phi @ solution)


def ours(
    robot: Robot, fits: list[Recording], held_out: Recording, side: str, cutoff: float
) -> tuple[dict[str, Errors], list[tuple[float, float]]]:
    """Return what description, `identify` and consistent arm miss of the held-out recording, and
    the spans judged.

    Parameters
    ----------
    robot, fits, held_out
        The description, and the recordings.
    side
        Where friction acts, "motor" or "link".
    cutoff
        Hz.
    """
    suffix = ":side=link" if side == "link" else ""
    offset = "joint_torque_offset" if side == "link" else None
    laws = [f"viscous_friction{suffix}", f"coulomb_friction{suffix}", *([offset] if offset else [])]
    result, identifier, *_ = identify_with(
        fits, robot, IdentificationSettings(effects=parse_laws(laws, robot)), validate=[held_out]
    )
    equations = identifier.equations
    samples = held_out.select(robot.joint_names).samples()
    arms = {"description": equations.base.T @ equations.nominal, "identify": result.Psi_base}
    if result.Psi is not None:
        arms["consistent"] = equations.base.T @ result.Psi
    name = next(
        side for side in equations.sides if equations.equations.equation(side).torque is not None
    )
    found = {}
    motions = [m for m in DerivativeStage(samples)(equations).motions if len(m) > 50]
    for arm, Psi in arms.items():
        left = []
        for motion in motions:
            rate = 1.0 / float(np.median(np.diff(motion.t)))
            error = equations.measured(motion)[name] - equations.predict(motion, Psi)[name]
            left.append(filtered(error, rate, cutoff) if cutoff < 0.45 * rate else error)
        found[arm] = Errors(np.concatenate([motion.t for motion in motions]), np.concatenate(left))
    print("\n".join(result.notes))
    return found, [(float(motion.t[0]), float(motion.t[-1])) for motion in motions]


def main() -> None:
    """Print a table of held-out rms, Nm."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", type=Path)
    parser.add_argument("fit", nargs="+", type=Path)
    parser.add_argument("--validate", required=True, type=Path)
    parser.add_argument(
        "--side", choices=("motor", "link"), default="motor", help="where friction acts"
    )
    parser.add_argument("--cutoff", type=float, default=8.0, help="Hz")
    asked = parser.parse_args()
    robot = load_robot(asked.robot)
    fits = [read_recording(path, None, robot.joint_names) for path in asked.fit]
    held_out = read_recording(asked.validate, None, robot.joint_names)
    other = plain(robot, fits, held_out, asked.cutoff)
    table, spans = ours(robot, fits, held_out, asked.side, asked.cutoff)
    judged = {"plain": other.within(spans)}
    judged |= {arm: errors.within([(other.t[0], other.t[-1])]) for arm, errors in table.items()}
    print(f"held-out rms below {asked.cutoff:g} Hz, Nm: {', '.join(robot.joint_names)}")
    for arm, errors in judged.items():
        print(f"{arm:12}", " ".join(f"{value:8.3g}" for value in errors.rms))


if __name__ == "__main__":
    main()
