"""Replay of a recording in MuJoCo, with the errors of each model's motion and torque.

Open loop, in windows: the arm starts in the recorded state and is driven by the motor torque: the
recorded one, or the one that the described controllers or electrics make of commands or duty.
Torque: MuJoCo's inverse dynamics of the recorded motion is compared with the same torque. Closed
loop, for models with feedback actuators and recorded references: the reference is their input.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, rms
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.observation import observe
from elastic_arm.formatting import JointUnits
from elastic_arm.mujoco.closed_loop import held, lead, play
from elastic_arm.recording import Recording
from elastic_arm.recording.made_torque import with_made_torque
from elastic_arm.robot.mjcf import MjcfArm, engine
from elastic_arm.robot.mjcf.drives import torque_delays

WINDOW = 0.2  # s


@dataclass(frozen=True)
class JointErrors:
    """How far a model is from a recording, (n,) each."""

    # position, velocity, torque: root mean squares, rad, rad/s and Nm
    position: Array
    velocity: Array
    torque: Array
    correlation: Array  # of the torque that the model needs with the torque recorded
    # s by which the recorded torque is later than the model's; NaN where no lag fits better than
    # none
    lag: Array


@dataclass(frozen=True)
class ReplayedCourse:
    """What was recorded and replayed, for figures: t (N,) s, the others (N, n)."""

    t: Array
    recorded: Array
    replayed: Array
    torque_recorded: Array
    torque_needed: Array


@dataclass(frozen=True)
class Replay:
    """A model on a recording."""

    name: str  # of the model
    joints: tuple[str, ...]  # names
    window: float  # s
    windows: int  # how many were replayed
    open_loop: JointErrors  # errors in windows
    # root mean square of the position error under the recorded reference (n,) rad; None where there
    # is none
    closed_loop: Array | None
    course: ReplayedCourse  # for figures
    prismatic: tuple[str, ...] = ()  # names of the joints that slide: their errors are in m and N
    torque: str = "recorded"  # how the driving torques are known: "recorded" or "computed"

    @property
    def units(self) -> JointUnits:
        """Units of quantities at the joints."""
        return JointUnits(self.joints, self.prismatic)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, courses left out."""
        errors = {
            name: _by_joint(self.joints, getattr(self.open_loop, name))
            for name in vars(self.open_loop)
        }
        closed = None if self.closed_loop is None else _by_joint(self.joints, self.closed_loop)
        return {
            "model": self.name,
            "window_s": self.window,
            "windows": self.windows,
            "open_loop": errors,
            "closed_loop_position": closed,
        }


def replay(recording: Recording, arm: MjcfArm, *, window: float = WINDOW, name: str = "") -> Replay:
    """Replay a recording of positions and motor torques in a model, whatever callbacks are attached
    to it included.

    The arm moves on its own for `window` s before it is put back to the recorded motion. Raises a
    DiagnosisError if the recording holds no motor torque, or is shorter than a window.
    """
    chosen = recording.select(arm.robot.joint_names)
    made = with_made_torque(chosen, arm.robot)
    observation = observe(made)
    lags = torque_delays(arm.model, arm.chain)
    pieces = [_rigid(piece) for piece in observation.corrected({"motor_torque": lags}, {}).pieces]
    margin = int(np.ceil(observation.margin * observation.rate))
    pieces = [_cut(piece, margin) for piece in pieces if len(piece) > 2 * margin]
    steps = round(window * observation.rate)
    if steps < 1 or not any(len(piece) > steps for piece in pieces):
        raise DiagnosisError(
            f"{recording.source or 'the recording'} has no interval of {window:g} s",
            "Give a shorter --window",
        )
    runs = [
        _open_loop(arm, piece, steps, 1.0 / observation.rate)
        for piece in pieces
        if len(piece) > steps
    ]
    used = [piece for piece in pieces if len(piece) > steps]
    needed = [_inverse(arm, piece) for piece in used]
    errors = _errors(used, runs, needed, observation.rate)
    course = _course(used, runs, needed, steps)
    windows = sum(int(np.isfinite(run[0][:, 0]).sum()) // steps for run in runs)
    played = play(arm, chosen)
    closed = None if played is None else rms(played.errors)
    return Replay(
        name or arm.robot.name,
        arm.robot.joint_names,
        window,
        windows,
        errors,
        closed,
        course,
        tuple(arm.robot.units.prismatic),
        "computed" if made.made_by else "recorded",
    )


def labels(found: Sequence[Replay]) -> list[str]:
    """Return names of models for tables: of their files without folders, where these differ."""
    short = [Path(one.name).name or one.name for one in found]
    return short if len(set(short)) == len(short) else [one.name for one in found]


def _by_joint(joints: Sequence[str], values: Array) -> dict[str, float | None]:
    return {
        joint: float(f"{v:.6g}") if np.isfinite(v) else None
        for joint, v in zip(joints, values, strict=True)
    }


def _rigid(piece: Motion) -> Motion:
    """Return the motion of joints without elasticity: one angle, and the motor's torque."""
    torque = piece.tau_m if piece.tau_m is not None else piece.tau_J
    if torque is None:
        raise DiagnosisError(
            "the recording contains no torque, so no simulation can be driven",
            "Record /motor_states",
        )
    q, dq, ddq = (
        (piece.q, piece.dq, piece.ddq)
        if piece.q is not None
        else (piece.theta, piece.dtheta, piece.ddtheta)
    )
    return replace(piece, q=q, dq=dq, ddq=ddq, tau_m=torque)


def _cut(piece: Motion, margin: int) -> Motion:
    kept = slice(margin, len(piece) - margin)
    return replace(piece, **{name: values[kept] for name, values in piece.channels().items()})  # type: ignore[arg-type]


def _present(values: Array | None) -> Array:
    assert values is not None  # _rigid has seen to it
    return values


def _open_loop(arm: MjcfArm, piece: Motion, steps: int, period: float) -> tuple[Array, Array]:
    """Return positions and velocities (N, n) replayed; NaN at the starts of windows and after the
    last."""
    mj = engine()
    model = arm.model
    q = _present(piece.q)
    dq = _present(piece.dq)
    ddq = _present(piece.ddq)
    torque = _present(piece.tau_m)
    data = mj.MjData(model)
    substeps = max(1, int(np.ceil(period / model.opt.timestep - 1e-9)))
    behind = lead(model, period / substeps)
    # Acts between two samples, as much earlier as velocities are.
    between = 0.5 - behind / period
    mean = (1.0 - between) * torque[:-1] + between * torque[1:]
    found = np.full((2, *q.shape), np.nan)
    positions = arm.positions
    dofs = arm.dofs
    hold = held(arm)
    with without(model, "ACTUATION", timestep=period / substeps):
        for start in range(0, len(q) - steps, steps):
            mj.mj_resetData(model, data)
            data.qpos[:] = arm.qpos
            data.qpos[positions] = q[start]
            data.qvel[dofs] = dq[start] - behind * ddq[start]
            for k in range(start, start + steps):
                data.qfrc_applied[dofs] = mean[k]
                for _ in range(substeps):
                    mj.mj_step(model, data)
                    hold(data)
                found[0, k + 1] = data.qpos[positions]
                found[1, k + 1] = data.qvel[dofs] + behind * data.qacc[dofs]
    return found[0], found[1]


@contextmanager
def without(model: Any, *parts: str, timestep: float | None = None) -> Iterator[None]:
    """Take parts of a model out for a while, by the names of their `mjtDisableBit`, and set its
    time step, s."""
    option = model.opt
    bits = engine().mjtDisableBit
    own = float(option.timestep), int(option.disableflags)
    option.timestep = own[0] if timestep is None else timestep
    for part in parts:
        option.disableflags |= int(getattr(bits, f"mjDSBL_{part}"))
    try:
        yield
    finally:
        option.timestep, option.disableflags = own


def _inverse(arm: MjcfArm, piece: Motion) -> Array:
    """Return the torque (N, n) that the model needs for the motion."""
    mj = engine()
    model = arm.model
    data = mj.MjData(model)
    q = _present(piece.q)
    dq = _present(piece.dq)
    ddq = _present(piece.ddq)
    found = np.empty_like(q)
    # What is held is held by forces that are none of the motors'; limits are for the drives to
    # keep.
    with without(model, "EQUALITY", "LIMIT", "CONTACT"):
        for k in range(len(q)):
            data.qpos[:] = arm.qpos
            data.qvel[:] = 0.0
            data.qacc[:] = 0.0
            data.qpos[arm.positions] = q[k]
            data.qvel[arm.dofs] = dq[k]
            data.qacc[arm.dofs] = ddq[k]
            mj.mj_inverse(model, data)
            found[k] = data.qfrc_inverse[arm.dofs]
    return found


def _errors(
    pieces: Sequence[Motion],
    runs: Sequence[tuple[Array, Array]],
    needed: Sequence[Array],
    rate: float,
) -> JointErrors:
    apart_q = np.concatenate(
        [run[0] - _present(piece.q) for piece, run in zip(pieces, runs, strict=True)]
    )
    apart_v = np.concatenate(
        [run[1] - _present(piece.dq) for piece, run in zip(pieces, runs, strict=True)]
    )
    torque = np.concatenate([_present(p.tau_m) for p in pieces])
    model = np.concatenate(needed)
    lags = [
        _lag(_present(piece.tau_m), own, rate) for piece, own in zip(pieces, needed, strict=True)
    ]
    weights = [len(piece) for piece in pieces]
    return JointErrors(
        np.sqrt(np.nanmean(apart_q**2, axis=0)),
        np.sqrt(np.nanmean(apart_v**2, axis=0)),
        rms(torque - model),
        np.array([_correlation(torque[:, i], model[:, i]) for i in range(torque.shape[1])]),
        np.average(lags, axis=0, weights=weights),
    )


def _correlation(a: Array, b: Array) -> float:
    a = a - a.mean()
    b = b - b.mean()
    size = np.sqrt((a @ a) * (b @ b))
    return float(a @ b / size) if size > 0 else float("nan")


def _lag(recorded: Array, needed: Array, rate: float) -> Array:
    """Return by how much the recorded torque is later than the needed one, (n,) s, between samples
    by a parabola."""
    most = max(2, int(0.05 * rate))  # s; beyond, a lag is not looked for
    found = np.full(recorded.shape[1], np.nan)
    if len(recorded) < 4 * most:
        return found
    inner = needed[most : len(needed) - most]
    for i in range(recorded.shape[1]):
        score = np.array(
            [
                -np.mean((recorded[most + k : len(recorded) - most + k, i] - inner[:, i]) ** 2)
                for k in range(-most, most + 1)
            ]
        )
        best = int(np.argmax(score))
        if 0 < best < 2 * most:
            left, middle, right = score[best - 1 : best + 2]
            curve = left - 2.0 * middle + right
            found[i] = (best - most + (0.5 * (left - right) / curve if curve else 0.0)) / rate
    return found


def _course(
    pieces: Sequence[Motion],
    runs: Sequence[tuple[Array, Array]],
    needed: Sequence[Array],
    steps: int,
) -> ReplayedCourse:
    piece, run, own = max(zip(pieces, runs, needed, strict=True), key=lambda each: len(each[0]))
    kept = slice(0, 20000)  # samples of a course that are kept for figures
    return ReplayedCourse(
        piece.t[kept], _present(piece.q)[kept], run[0][kept], _present(piece.tau_m)[kept], own[kept]
    )
