"""The initial state of an arm: motors at rest, and links in equilibrium in drives and bearings."""

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import SimulationError
from elastic_arm.simulation.assembly import System

# A residual torque below this counts as equilibrium, Nm.
TOLERANCE = 1e-9
ITERATIONS = 100
# Deflection from which a second search begins, rad: beyond every play, where a drive's torque has a
# slope.
WOUND = 5e-3
# Largest deflection of an equilibrium, rad: an arm that hangs upside down in its drives is none.
NEARBY = 0.5


def equilibrium(system: System, theta: Array, speed: Array) -> tuple[Array, Array]:
    """Solve for the static deflection under gravity with the motors held at `theta`."""
    n = system.n
    dof = system.dof
    motor = slice(n, 2 * n) if dof > n else slice(0, n)
    free = np.array([k for k in range(dof) if not motor.start <= k < motor.stop], dtype=int)
    x = np.zeros(dof)
    x[:n] = x[motor] = theta
    rest = np.zeros(dof)
    z = np.zeros(system.states)
    given = (system.equations.nominal, system.effect_set.numbers(), speed)
    load = np.array(system.balance(x, rest, z, *given)).ravel()[free]
    found = _solved(system, x, free, given)
    if found is None:
        # Within its play a drive holds nothing, and the slope of gravity alone may point away from
        # the loaded end.
        wound = x.copy()
        wound[free] -= WOUND * np.sign(load) * (np.abs(load) > TOLERANCE)
        found = _solved(system, wound, free, given)
        if found is not None and not _is_stable(system, found[0], x, free, given):
            found = None
    if found is None:
        worst = int(np.abs(load).argmax())
        raise SimulationError(
            "no static equilibrium was found with the motors at"
            f" {np.array2string(theta, precision=3)} rad: the largest remaining torque is"
            f" {np.abs(load[worst]):.3g} Nm at"
            f" {system.equations.robot.joint_names[free[worst] % n]}",
            "Check stiffness, masses and the effects' parameters.",
        )
    return found[0], found[1][motor]


def _solved(
    system: System, x: Array, free: Array, given: tuple[Array, Array, Array]
) -> tuple[Array, Array] | None:
    """Return coordinates and torques (dof,) of an equilibrium by Newton's steps from x (dof,); None
    where none is."""
    rest = np.zeros(system.dof)
    z = np.zeros(system.states)
    torque = np.array(system.balance(x, rest, z, *given)).ravel()
    for _ in range(ITERATIONS):
        if np.abs(torque[free]).max(initial=0.0) < TOLERANCE * (1.0 + np.abs(torque).max()):
            return x, torque
        slope = np.array(system.stiffness_of_balance(x, rest, z, *given))[np.ix_(free, free)]
        change = np.linalg.lstsq(slope, -torque[free], rcond=None)[0]
        x, torque = _descend(system, x, torque, free, change, given)
    return None


def _is_stable(
    system: System, x: Array, held: Array, free: Array, given: tuple[Array, Array, Array]
) -> bool:
    """Whether an arm stays at coordinates x (dof,), which are near those of the motors, held
    (dof,)."""
    rest = np.zeros(system.dof)
    z = np.zeros(system.states)
    slope = np.array(system.stiffness_of_balance(x, rest, z, *given))[np.ix_(free, free)]
    bends_back = np.linalg.eigvalsh(0.5 * (slope + slope.T)).min() > 0.0
    return bool(np.abs(x - held).max() < NEARBY and bends_back)


def _descend(
    system: System,
    x: Array,
    torque: Array,
    free: Array,
    change: Array,
    given: tuple[Array, Array, Array],
) -> tuple[Array, Array]:
    """Take the longest of the halved Newton steps that makes the residual smaller."""
    rest = np.zeros(system.dof)
    z = np.zeros(system.states)
    size = np.abs(torque[free]).max()
    for halvings in range(20):
        trial = x.copy()
        trial[free] += change / 2**halvings
        found = np.array(system.balance(trial, rest, z, *given)).ravel()
        if np.abs(found[free]).max() < size:
            return trial, found
    return trial, found
