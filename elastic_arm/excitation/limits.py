"""The limits of an arm, and how much of them a motion uses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model
from elastic_arm.excitation.fourier import FourierTrajectory, require
from elastic_arm.excitation.workspace import Workspace
from elastic_arm.formatting import JointUnits
from elastic_arm.robot.description import Robot

# Where the description states none: a full turn, and what a heavy arm does without haste. Torque is
# not limited then.
DEFAULTS: dict[str, float] = {
    "position_min": -np.pi,
    "position_max": np.pi,
    "velocity": 1.5,
    "acceleration": 6.0,
    "torque": np.inf,
}
# The same of prismatic joints, in m and N: half a metre of travel, at the pace of a gantry without
# haste.
LINEAR_DEFAULTS: dict[str, float] = {
    "position_min": -0.25,
    "position_max": 0.25,
    "velocity": 0.3,
    "acceleration": 1.0,
    "torque": np.inf,
}
UNITS = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s²",
    "torque": "Nm",
    "floor": "m",
    "links": "m",
}
# Clearance to the floor and between links that a motion keeps, m: what a tracking error of some
# mrad at a metre's reach and capsules that are only roughly the links take away.
MARGIN = 0.02
# Samples of a period of the highest harmonic: a peak between two samples exceeds them by less than
# 1 %.
SAMPLES_PER_WAVE = 24
FEWEST_SAMPLES = 200


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of all joints, (n,) each, and of the workspace.

    See :data:`DEFAULTS` and :data:`LINEAR_DEFAULTS`.
    """

    joints: tuple[str, ...]  # their names
    # position_min, position_max, velocity, acceleration, torque: rad, rad/s, rad/s^2, Nm, of
    # prismatic joints m, m/s, m/s^2, N; torque at the harmonic-drive output, infinite where
    # unlimited
    position_min: Array
    position_max: Array
    velocity: Array
    acceleration: Array
    torque: Array
    workspace: Workspace | None = None  # None where the arm may go everywhere
    margin: float = (
        MARGIN  # smallest gap to the floor and between links, m; :data:`MARGIN` by default
    )
    assumed: tuple[str, ...] = ()  # sentences on limits that the description does not state
    units: JointUnits = field(default_factory=lambda: JointUnits(()))  # of the joints

    def __post_init__(self) -> None:
        sane = bool(np.isfinite(self.margin)) and self.margin >= 0.0
        require(sane, f"the safety margin is {self.margin:g} m", "Give zero or a positive length")
        for joint, low, high in zip(self.joints, self.position_min, self.position_max, strict=True):
            span = (
                f"{joint} has the position limits {low:g} to {high:g} {self.units.at(joint, 'rad')}"
            )
            require(low < high, span, "State both position limits of that joint")

    @classmethod
    def of(
        cls,
        robot: Robot,
        *,
        velocity: float | None = None,
        acceleration: float | None = None,
        torque: float | None = None,
        workspace: Workspace | None = None,
        margin: float = MARGIN,
    ) -> MotionLimits:
        """Take the limits of `robot`, lowered to the given ones.

        Where it states none, the given ones count, else defaults; the given ones are for all joints
        alike.
        """
        values: dict[str, Array] = {}
        assumed: list[str] = []
        given = {"velocity": velocity, "acceleration": acceleration, "torque": torque}
        for name in DEFAULTS:
            defaults = [
                (LINEAR_DEFAULTS if joint.prismatic else DEFAULTS)[name] for joint in robot.joints
            ]
            stated = [getattr(joint.limits, name) for joint in robot.joints]
            limit = given.get(name)
            if limit is not None:
                positive = bool(np.isfinite(limit)) and limit > 0.0
                require(positive, f"the {name} limit is {limit:g}", "Give a number above zero")
                stated = [limit if value is None else min(value, limit) for value in stated]
            both = list(zip(stated, defaults, strict=True))
            values[name] = np.array(
                [default if value is None else value for value, default in both], dtype=float
            )
            unknown: dict[str, list[str]] = {}
            for joint, (value, default) in zip(robot.joint_names, both, strict=True):
                if value is None:
                    unit = robot.units.at(joint, UNITS[name.partition("_")[0]])
                    unknown.setdefault(
                        "no limit" if np.isinf(default) else f"{default:.3g} {unit}", []
                    ).append(joint)
            what = name.replace("_", " ")
            assumed += [
                f"{what} of {', '.join(joints)}: {words} assumed"
                for words, joints in unknown.items()
            ]
        workspace = workspace or Workspace.of(robot)
        return cls(
            robot.joint_names,
            **values,
            workspace=workspace,
            margin=margin,
            assumed=tuple(assumed),
            units=robot.units,
        )

    @property
    def centre(self) -> Array:
        """Middle of the position range (n,), rad."""
        return 0.5 * (self.position_min + self.position_max)

    @property
    def half_range(self) -> Array:
        """Half the position range (n,), rad."""
        return 0.5 * (self.position_max - self.position_min)

    def fitted(self, trajectory: FourierTrajectory, share: float = 1.0) -> FourierTrajectory:
        """Return the motion with joints turned down to `share` of their kinematic limits."""
        q, dq, ddq = trajectory.evaluate(limit_times(trajectory))
        swing = q - trajectory.q0
        below = share * self.half_range + trajectory.q0 - self.centre
        above = share * self.half_range - trajectory.q0 + self.centre
        uses = [
            _ratio(-swing.min(axis=0), below),
            _ratio(swing.max(axis=0), above),
            np.abs(dq).max(axis=0) / (share * self.velocity),
            np.abs(ddq).max(axis=0) / (share * self.acceleration),
        ]
        return trajectory.scaled(1.0 / np.maximum(1.0, np.max(uses, axis=0)))

    def use(self, trajectory: FourierTrajectory, model: Model, t: Array | None = None) -> LimitUse:
        """Return how much of every limit a motion uses, start and stop included.

        Torque is the rigid arm's, theta = q: the deflections of a stiff drive change it little.
        """
        q, dq, ddq = trajectory.evaluate(limit_times(trajectory) if t is None else t)
        tau = rigid_torque(model, q, dq, ddq)
        floor = np.inf
        links = np.inf
        if self.workspace is not None:
            floor, links = (float(gap.min()) for gap in self.workspace.clearance(q))
        return LimitUse(
            self.joints,
            position=np.abs(q - self.centre).max(axis=0) / self.half_range,
            velocity=np.abs(dq).max(axis=0) / self.velocity,
            acceleration=np.abs(ddq).max(axis=0) / self.acceleration,
            torque=np.abs(tau).max(axis=0) / self.torque,
            peak_torque=np.abs(tau).max(axis=0),
            floor=floor,
            links=links,
            margin=self.margin,
        )


@dataclass(frozen=True, eq=False)
class LimitUse:
    """Peaks of a motion as shares of the limits, (n,) each: 1 is at the limit.

    `peak_torque` is in Nm; `floor` and `links` are the smallest gaps, m, negative where a link goes
    through something, infinite where there is nothing; `margin` is how large they must be.
    """

    joints: tuple[str, ...]
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    peak_torque: Array
    floor: float
    links: float
    margin: float
    kinds: tuple[str, ...] = field(
        default=("position", "velocity", "acceleration", "torque"), init=False
    )

    @property
    def excess(self) -> Array:
        """Violation of each limit (6,), at most 0 where it is kept.

        Four shares, and two clearances in m.
        """
        shares = [float(getattr(self, kind).max()) - 1.0 for kind in self.kinds]
        gaps = [-1.0 if np.isinf(gap) else self.margin - gap for gap in (self.floor, self.links)]
        return np.array(shares + gaps)

    @property
    def kept(self) -> bool:
        """Whether every limit is kept."""
        return bool((self.excess <= 1e-9).all())

    def worst(self) -> str:
        """Return in words which limit is broken most."""
        index = int(np.argmax(self.excess))
        if index < len(self.kinds):
            shares = getattr(self, self.kinds[index])
            joint = int(np.argmax(shares))
            return (
                f"the {self.kinds[index]} of {self.joints[joint]} reaches {100 * shares[joint]:.0f}"
                " % of its limit"
            )
        what = "the floor"
        gap = self.floor
        if index > len(self.kinds):
            what = "another link"
            gap = self.links
        if gap < 0.0:
            return f"a link penetrates {what} by {-1e3 * gap:.0f} mm"
        return (
            f"a link is within {1e3 * gap:.1f} mm of {what}; the margin is {1e3 * self.margin:g} mm"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, null where there is no limit."""
        shares = {
            kind: dict(zip(self.joints, getattr(self, kind).tolist(), strict=True))
            for kind in self.kinds
        }
        both = (("floor", self.floor), ("links", self.links))
        gaps = {f"{name}_gap_m": None if np.isinf(gap) else gap for name, gap in both}
        gaps["margin_m"] = self.margin
        peaks = dict(zip(self.joints, self.peak_torque.tolist(), strict=True))
        return {"share_of_limit": shares, "peak_torque_Nm": peaks, **gaps}

    def share(self, kind: str, joint: int) -> float | None:
        """Return the used share of a joint's limit; None for a torque that is not limited."""
        unlimited = kind == "torque" and self.torque[joint] == 0.0 and self.peak_torque[joint] > 0.0
        return None if unlimited else float(getattr(self, kind)[joint])

    def gaps(self) -> list[tuple[str, float]]:
        """Return the smallest gaps, m, by what is met there.

        Nothing where there is nothing to meet.
        """
        return [
            (name, gap)
            for name, gap in (("the floor", self.floor), ("another link", self.links))
            if gap < np.inf
        ]


def limit_times(trajectory: FourierTrajectory) -> Array:
    """Return times at which a motion's peaks are found.

    They are those of the ramps and of one period.
    """
    span = min(trajectory.duration, trajectory.period + 2.0 * trajectory.ramp)
    per_period = max(FEWEST_SAMPLES, SAMPLES_PER_WAVE * trajectory.harmonics)
    t = np.linspace(0.0, span, int(np.ceil(per_period * span / trajectory.period)) + 1)
    # Where more periods follow, the stop is the end of the trajectory, not of the first period.
    return np.where(t > span - trajectory.ramp, t + trajectory.duration - span, t)


def generalized(model: Model, values: Array) -> Array:
    """Return joint values (N, n) as coordinates (N, dof): theta = q, no tilt of bearings."""
    x = np.zeros((len(values), model.dof))
    for k in range(2 if model.robot.elastic else 1):
        x[:, k * model.n : (k + 1) * model.n] = values
    return x


def rigid_torque(model: Model, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the torque (N, n) Nm that moves the arm with stiff drives.

    It is both rows of (1) together.
    """
    rows = model.inverse_dynamics(*(generalized(model, values) for values in (q, dq, ddq)))
    return rows[:, : model.n] + (rows[:, model.n : 2 * model.n] if model.robot.elastic else 0.0)


def _ratio(swing: Array, clearance: Array) -> Array:
    """Return swing over clearance; huge where there is no clearance."""
    return np.where(swing <= 0.0, 0.0, swing / np.maximum(clearance, 1e-9))
