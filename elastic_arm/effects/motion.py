"""The symbols of a law: the motion of an arm, and the contribution of a law to its equations.

All entries are CasADi expressions. The simulator replaces them by the state that it integrates, and
the diagnosis by the channels of a recording; a law does not depend on which.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.errors import EffectError
from elastic_arm.robot import Robot, Transmission

# of Newton from the deflection that was read: to a thousandth where that is within a half of it
STEPS = 4
# A law that falls as fast as its spring rises leaves no deflection that carries the load: least
# slope of both, over K.
LEAST = 0.1

SX = ca.SX


@dataclass(frozen=True)
class Contribution:
    """What an effect adds to each joint's three residuals, and how its states move."""

    # link, drive, motor: (n, 1) Nm, added to `tau_J - (model's link torque)`, `tau_J - K (theta -
    # q) - D (dtheta - dq)` and `tau_m - (model's motor torque) - tau_J`: positive where the arm
    # resists more than the model
    link: SX
    drive: SX
    motor: SX
    tilts: SX | None = (
        None  # (2n, 1) Nm, the same for the bearing tilts; None where bearings are rigid
    )
    # name of an internal state -> its time derivative
    rates: Mapping[str, SX] = field(default_factory=dict)

    def __add__(self, other: Contribution) -> Contribution:
        tilts = [c.tilts for c in (self, other) if c.tilts is not None]
        return Contribution(
            self.link + other.link,
            self.drive + other.drive,
            self.motor + other.motor,
            sum(tilts[1:], tilts[0]) if tilts else None,
            {**self.rates, **other.rates},
        )


@dataclass(frozen=True)
class SymbolicMotion:
    """The motion of an arm over symbols."""

    equations: ArmEquations  # the arm's own equations, for laws that change them
    # x, dx, ddx: (dof, 1) Generalized coordinates `[q, theta]`, `[q, theta, q_x, q_y]`, or `[q]`
    # for an arm without transmissions
    x: SX
    dx: SX
    ddx: SX
    # tau_J, tau_m, dtau_J, dtau_m: (n, 1) Joint torque and motor torque, and their rates
    tau_J: SX
    tau_m: SX
    dtau_J: SX
    dtau_m: SX
    # (side, joint index) -> sign of that side's velocity: exact in a diagnosis, regularised in a
    # simulator
    sign: Callable[[str, int], SX]
    # twist, twist_rate: (n, 1) What transmission errors add to the deflection, and its rate
    twist: SX | float = 0.0
    twist_rate: SX | float = 0.0
    # dddx, ddddx: (dof, 1) Third and fourth derivative of x, where somebody knows them
    dddx: SX | float = 0.0
    ddddx: SX | float = 0.0
    # (t - t_mid) / T over a recording of length T, from -1/2 to 1/2; None where no law takes it
    progress: SX | None = None
    elapsed: SX | None = None  # t - t_begin over a recording, s; None where no law takes it
    # friction_link, friction_motor: (n, 1) What friction effects add to both sides, Nm
    friction_link: SX | None = None
    friction_motor: SX | None = None
    # (n, 1) The deflection of springs that carry the load a model predicts, less what laws carry
    # that do not follow it; None where it is not known
    wound: SX | None = None
    loaded: SX | float = 1.0  # (1, 1) Whether `wound` is that, 1 or 0
    # r, dr: (n, 1) Commands of the controllers that made tau_m, and their rates; None where it was
    # measured
    r: SX | None = None
    dr: SX | None = None
    # kp, kd, fed: (n, 1) Their gains of the errors of angles and rates, and what else they make, Nm
    kp: SX | None = None
    kd: SX | None = None
    fed: SX | None = None
    stall: SX | None = None  # (n, 1) Their torque of full duty, Nm; zero where none is stated

    @property
    def robot(self) -> Robot:
        """The arm the equations are of."""
        return self.equations.robot

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    def _motor(self, coordinates: SX) -> SX:
        # Without transmissions the motor turns with the link.
        return coordinates[self.n : 2 * self.n] if self.robot.elastic else coordinates[: self.n]

    @property
    def q(self) -> SX:
        """Link angles (n, 1)."""
        return self.x[: self.n]

    @property
    def dq(self) -> SX:
        """Their rates."""
        return self.dx[: self.n]

    @property
    def ddq(self) -> SX:
        """Their accelerations."""
        return self.ddx[: self.n]

    @property
    def theta(self) -> SX:
        """Motor angles at the harmonic-drive output (n, 1)."""
        return self._motor(self.x)

    @property
    def dtheta(self) -> SX:
        """Their rates."""
        return self._motor(self.dx)

    @property
    def ddtheta(self) -> SX:
        """Their accelerations."""
        return self._motor(self.ddx)

    @property
    def deflection(self) -> SX:
        """d = theta + e(theta) - q, e the transmission error of the effects that act."""
        return self.theta + self.twist - self.q

    def deflection_under_load(self, i: int, law: Callable[[SX], SX]) -> SX:
        """Return the deflection at which spring i and a law beside it carry the load.

        The law is nearly a stiffness.

        The stiffness itself is regressed on the predicted load. Beside it a column of the encoders'
        deflection would fit their noise, which the residual holds, too (errors in variables;
        Fuller, Measurement Error Models, 1987). Where the load is not known it is the deflection.
        """
        read = self.deflection[i]
        if self.wound is None:
            return read
        d = ca.SX.sym("d")
        K = self.K[i]
        wound = self.wound[i]
        carried = law(d)
        slope = ca.fmax(1.0 + ca.jacobian(carried, d) / K, LEAST)
        step = (wound - d - carried / K) / slope
        most = ca.fabs(wound) + ca.fabs(read)
        found = read
        for _ in range(STEPS):
            # Beyond the fold of a falling law no deflection carries the load.
            found = ca.fmax(-most, ca.fmin(most, found + ca.substitute(step, d, found)))
        return ca.if_else(self.loaded > 0.0, found, read)

    @property
    def deflection_rate(self) -> SX:
        """Its rate."""
        return self.dtheta + self.twist_rate - self.dq

    @property
    def K(self) -> SX:
        """Nominal stiffnesses (n, 1)."""
        return self.equations.K

    @property
    def D(self) -> SX:
        """Nominal dampings (n, 1)."""
        return self.equations.D

    def left_side(self, model: str) -> SX:
        """Return the left side of (1) in a variant of this arm, nominal, (dof, 1)."""
        return self.equations.left_side(self.x, self.dx, self.ddx, model=model)

    def carried_body(self, link: int, mass: SX, moment: SX, inertia: SX) -> SX:
        """Return what a body fixed to `link` (index) adds to (1)'s left side, (dof, 1)."""
        return self.equations.carried_body(link, mass, moment, inertia, self.x, self.dx, self.ddx)

    def velocity(self, side: str) -> SX:
        """Return the velocities (n, 1) of a side, "link" or "motor"."""
        return self.dq if side == "link" else self.dtheta

    def friction(self, side: str) -> SX:
        """Return what the friction effects of a side, "link" or "motor", resist with (n, 1), Nm."""
        torque = self.friction_link if side == "link" else self.friction_motor
        return SX(self.n, 1) if torque is None else torque

    def gear(self, i: int) -> Transmission:
        """Return the transmission of joint i."""
        transmission = self.robot.joints[i].transmission
        if transmission is None:
            raise EffectError(
                f"robot {self.robot.name} has no transmissions, so this effect cannot act",
                "Use an effect of the motor or link side, or an arm file with transmissions.",
            )
        return transmission

    def motor_inertia(self, i: int) -> SX:
        """Return the inertia on the motor side of joint i, kg m²."""
        joint = self.robot.joints[i]
        if joint.transmission is None and not joint.armature:
            raise EffectError(
                f"robot {self.robot.name} has no motor inertia at {joint.name}",
                "State its armature (kg m²) in the arm file, or use an arm file with"
                " transmissions.",
            )
        return self.equations.B[i]

    def at(self, i: int, *, rates: Mapping[str, SX] | None = None, **torques: Any) -> Contribution:
        """Return a contribution to joint i alone; `torques` are `link`, `drive`, `motor` in Nm."""
        sides = {name: SX(self.n, 1) for name in ("link", "drive", "motor")}
        for name, torque in torques.items():
            if name not in sides:
                raise EffectError(
                    f"a law adds a torque to {name!r}", f"Choose among {', '.join(sides)}."
                )
            sides[name][i] = torque
        return Contribution(**sides, rates=rates or {})

    def everywhere(self, rows: SX) -> Contribution:
        """Return a contribution of `rows` (dof, 1), an addition to the left side of (1)."""
        n = self.n
        if not self.robot.elastic:
            return Contribution(rows, SX(n, 1), SX(n, 1))
        tilts = rows[2 * n :] if rows.shape[0] > 2 * n else None
        return Contribution(rows[:n], SX(n, 1), rows[n : 2 * n], tilts)

    def nothing(self) -> Contribution:
        """Return the contribution of no effect."""
        return self.at(0)
