"""The equations that the recorded channels allow, as combinations of three residuals per joint.

With every channel recorded, each joint has three residuals, from (1) and the law of the drive::

    link    tau_J - (M q'' + S theta'' + c + c1 + g)
    drive   tau_J - K (theta - q) - D (theta' - q')
    motor   tau_m - (S' q'' + B theta'' + c2) - tau_J

A missing channel cancels in some of their combinations and makes the others unusable. An
:class:`EquationSet` is one of two bases of the usable combinations:

direct
    The residuals themselves if their channels were recorded, so that each keeps its place in the
    arm. They share the noise of tau_J, which the covariance of :mod:`.whitening` includes.
independent
    Combinations that do not share a torque sensor, so that each can be weighted by itself. With
    both encoders, these are the lines of (1), `link - drive` (without torque) and `drive + motor`
    (tau_m), and the law of the drive (tau_J). With the encoders of one side, theta = q, and they
    are `link` (tau_J) and `link + motor` (tau_m).

If only some joints have a channel, the equations are chosen joint by joint.
:meth:`EquationSet.even` then gives all joints the same names of equations, for arrays of names
times joints: equations that a joint lacks are void (null combinations). A joint without a torque
has no equation, except that of its link with both encoders.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elastic_arm.arrays import Array, Mask
from elastic_arm.dynamics import Model
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.robot.parts import CONTROLLED

Channels = Collection[str]
Place = tuple[str, str]  # joint and side of a residual

SIDES = ("link", "drive", "motor")
# position of these equations in a combination
LINK = 0
DRIVE = 1
MOTOR = 2
TORQUES = ("tau_J", "tau_m")
# Coefficients of tau_J and tau_m in the rows link, drive, motor.
_TORQUE_COEFFICIENTS = np.array([[1, 0], [1, 0], [-1, 1]])


@dataclass(frozen=True)
class Equation:
    """One equation of a joint."""

    # "link", "drive", "motor"; with the encoders of one side only "joint" (up to tau_J) and "whole"
    # (up to tau_m)
    name: str
    combination: tuple[int, int, int]  # coefficients of the residuals link, drive and motor in it

    @property
    def torque(self) -> str | None:
        """Channel that it is an equation for; None with no torque, or both."""
        held = np.array(self.combination) @ _TORQUE_COEFFICIENTS
        found = [name for name, coefficient in zip(TORQUES, held, strict=True) if coefficient]
        return found[0] if len(found) == 1 else None

    @property
    def lines(self) -> tuple[int, int, int]:
        """Coefficients of the link's and motor's line of (1) and of the spring torque.

        The lines include the springs.

        The lines hold the spring with opposite signs; the residuals hold the torque sensor in its
        place.
        """
        link, drive, motor = self.combination
        return link, motor, link + drive - motor


_DIRECT = {
    side: Equation(side, (int(side == "link"), int(side == "drive"), int(side == "motor")))
    for side in SIDES
}
# Without joint torque sensors the drive's law stands in for them.
_WITHOUT_SENSOR = {"link": Equation("link", (1, -1, 0)), "motor": Equation("motor", (0, 1, 1))}
# One encoder alone, no joint torque sensor: the arm as a whole, its springs bridged.
_BRIDGED = Equation("motor", (1, 0, 1))
_INDEPENDENT = {
    **_WITHOUT_SENSOR,
    "drive": _DIRECT["drive"],
    "joint": Equation("joint", (1, 0, 0)),
    "whole": Equation("whole", (1, 0, 1)),
}
VOID = (0, 0, 0)  # combination of an equation that a joint lacks
_ALIKE = {"joint": "drive", "whole": "motor"}


@dataclass(frozen=True)
class EquationSet:
    """The usable equations, row by row: those of one name for all joints, then the next."""

    n: int  # joints
    entries: tuple[tuple[Equation, int], ...]  # equation and joint index of each row

    @classmethod
    def direct(
        cls, recorded: Channels | Sequence[Channels], n: int, *, elastic: bool = True
    ) -> EquationSet:
        """Return the residuals themselves as far as their channels were recorded.

        recorded: names among q, theta, tau_J, tau_m: one set for all joints, or a sequence of n
        sets; elastic: whether the joints have transmissions; without them both encoders read one
        angle, and nothing winds.

        Raises an IdentificationError if the channels allow no equation.
        """
        return cls._of(
            [_direct(names, elastic=elastic) for names in _of_joints(recorded, n)], tuple(SIDES)
        )

    @classmethod
    def of(cls, motion: Motion, model: Model) -> EquationSet:
        """Return the residuals that a motion's channels allow, every name for every joint."""
        recorded = [motion.recorded_at(joint) for joint in range(model.n)]
        return cls.direct(recorded, model.n, elastic=model.robot.elastic).even()

    @classmethod
    def independent(
        cls,
        recorded: Channels | Sequence[Channels],
        n: int,
        *,
        elastic: bool = True,
        summed: bool = False,
    ) -> EquationSet:
        """Return equations whose noises are independent.

        recorded: names among q, theta, tau_J, tau_m: one set for all joints, or a sequence of n
        sets; elastic: whether the joints have transmissions; without them both encoders read one
        angle; summed: whether, without joint torque sensors, the motor's row is the sum of both
        lines of (1), in which no spring is left: torque then sets the scale of every mass, and the
        spring stands in the link's row alone.

        Raises an IdentificationError if the channels allow no equation.
        """
        found = [
            _independent(names, elastic=elastic, summed=summed) for names in _of_joints(recorded, n)
        ]
        return cls._of(found, tuple(_INDEPENDENT))

    @classmethod
    def _of(cls, found: Sequence[dict[str, Equation]], order: Sequence[str]) -> EquationSet:
        entries = tuple(
            (own[name], joint) for name in order for joint, own in enumerate(found) if name in own
        )
        return cls(len(found), entries)

    def even(self) -> EquationSet:
        """Return the set with every name for every joint: void where a joint lacks it.

        A joint with the encoders of one side alone has its equations under the names that both
        sides' have for the same torque: "joint" as "drive", "whole" as "motor".
        """
        if len(self.entries) == len(self.sides) * self.n:
            return self
        mixed = bool({"joint", "whole"} & set(self.sides)) and bool(set(SIDES) & set(self.sides))
        renamed = _ALIKE if mixed else {}
        own: list[dict[str, Equation]] = [{} for _ in range(self.n)]
        for equation, joint in self.entries:
            name = renamed.get(equation.name, equation.name)
            own[joint][name] = Equation(name, equation.combination)
        names = dict.fromkeys(renamed.get(name, name) for name in self.sides)
        entries = [
            (found.get(name, Equation(name, VOID)), joint)
            for name in names
            for joint, found in enumerate(own)
        ]
        return EquationSet(self.n, tuple(entries))

    @property
    def live(self) -> Mask:
        """Which rows (R,) are no void ones."""
        return np.array([equation.combination != VOID for equation, _ in self.entries])

    @property
    def without_rows(self) -> tuple[int, ...]:
        """Indices of the joints that have void rows alone, as without a torque."""
        live = {joint for equation, joint in self.entries if equation.combination != VOID}
        return tuple(joint for joint in range(self.n) if joint not in live)

    def places(self, joints: Sequence[str]) -> list[tuple[str, str]]:
        """Return joint and side of each row that is no void one."""
        return [
            (joints[joint], equation.name)
            for equation, joint in self.entries
            if equation.combination != VOID
        ]

    def of_joint(self, side: str, joint: int) -> Equation:
        """Return the equation of a name and a joint of an even set."""
        return next(
            equation for equation, own in self.entries if equation.name == side and own == joint
        )

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the equations, each once."""
        return tuple(dict.fromkeys(equation.name for equation, _ in self.entries))

    @property
    def rows(self) -> int:
        """Number of rows R."""
        return len(self.entries)

    @property
    def torques(self) -> tuple[str, ...]:
        """The torque channels that some equation holds."""
        held = (
            np.array([equation.combination for equation, _ in self.entries]) @ _TORQUE_COEFFICIENTS
        )
        return tuple(name for name, column in zip(TORQUES, held.T, strict=True) if column.any())

    @property
    def reads_torque_by_deflection(self) -> bool:
        """Whether both encoders stand in for joint torque sensors."""
        return any(
            equation.combination == _WITHOUT_SENSOR["link"].combination
            for equation, _ in self.entries
        )

    def equation(self, side: str) -> Equation:
        """Return the equation of a name, as the first joint that has it has it."""
        return next(
            equation
            for equation, _ in self.entries
            if equation.name == side and equation.combination != VOID
        )

    @cached_property
    def transform(self) -> Array:
        """From the full rows [link, drive, motor], n each, to the usable ones: (R, 3 n)."""
        transform = np.zeros((self.rows, 3 * self.n))
        for row, (equation, joint) in enumerate(self.entries):
            transform[row, joint :: self.n] = equation.combination
        return transform

    @cached_property
    def apart(self) -> Array:
        """Combinations (R, R) of rows, at most one a joint with its torque sensor.

        The last row that holds tau_J alone stays, and is taken off the others. How badly the noise
        of that sensor is known then spoils one row, not what the rows have in common.
        """
        found = np.eye(self.rows)
        held = (
            np.array([equation.combination for equation, _ in self.entries]) @ _TORQUE_COEFFICIENTS
        )
        for joint in range(self.n):
            own = [row for row, (_, at) in enumerate(self.entries) if at == joint and held[row, 0]]
            alone = [row for row in own if not held[row, 1]]
            for row in own if alone else ():
                if row != alone[-1]:
                    found[row, alone[-1]] = -held[row, 0] / held[alone[-1], 0]
        return found

    def combine(self, columns: Array) -> Array:
        """Carry columns (N, 3 n, k) of the full rows over to the usable ones, (N, R, k)."""
        if np.array_equal(self.transform, np.eye(3 * self.n)):
            return columns
        return np.tensordot(columns, self.transform, axes=(1, 1)).transpose(0, 2, 1)


def _of_joints(recorded: Channels | Sequence[Channels], n: int) -> list[frozenset[str]]:
    """Return the channels of each joint.

    Raises an IdentificationError if a joint has no position, or none has a torque.
    """
    per_joint = isinstance(recorded, Sequence) and not all(
        isinstance(entry, str) for entry in recorded
    )
    each: Sequence[Channels] = list(recorded) if per_joint else [recorded] * n  # type: ignore[list-item]
    found = [frozenset(names) for names in each]
    if not all(names & {"q", "theta"} for names in found):
        raise IdentificationError(
            "no positions were recorded", "Record /joint_states or /motor_states."
        )
    if not any(names & set(TORQUES) for names in found):
        raise IdentificationError(
            "no torque was recorded: neither tau_J (effort of /joint_states) nor tau_m (effort of"
            " /motor_states)",
            f"Record a torque, or map a motor current with a channel map; {CONTROLLED}.",
        )
    return found


def _direct(recorded: frozenset[str], *, elastic: bool) -> dict[str, Equation]:
    """Return the residuals of one joint that hold no missing channel, by name."""
    both = elastic and {"q", "theta"} <= recorded
    if "tau_J" in recorded:
        # Beside a joint torque sensor the motor's acceleration follows from the link's, as does a
        # rigid link's from it.
        shown = {
            "link": "q" in recorded or not elastic,
            "drive": both,
            "motor": "tau_m" in recorded,
        }
        found = {side: _DIRECT[side] for side, usable in shown.items() if usable}
    elif both:
        found = {
            side: _WITHOUT_SENSOR[side]
            for side in ("link", *(("motor",) if "tau_m" in recorded else ()))
        }
    else:
        found = {"motor": _BRIDGED} if "tau_m" in recorded else {}
    if not found and "tau_J" in recorded:
        raise IdentificationError(
            "motor angles and joint torques alone give no equation",
            "Record link angles or motor torques as well.",
        )
    return found


def _independent(recorded: frozenset[str], *, elastic: bool, summed: bool) -> dict[str, Equation]:
    """Return the equations of one joint with independent noises, by name."""
    if summed and elastic and {"q", "theta", "tau_m"} <= recorded and "tau_J" not in recorded:
        return {"link": _WITHOUT_SENSOR["link"], "motor": _BRIDGED}
    if elastic and {"q", "theta"} <= recorded:
        names = {"link": "q", "motor": "tau_m", "drive": "tau_J"}
    else:
        names = {"joint": "tau_J", "whole": "tau_m"}
    return {name: _INDEPENDENT[name] for name, channel in names.items() if channel in recorded}
