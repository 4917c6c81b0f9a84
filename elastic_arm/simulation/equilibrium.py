"""Where an arm starts: the motors held still, the links hanging in their drives and bearings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import SimulationError
from elastic_arm.simulation.assembly import System

Array = NDArray[np.float64]

# A residual torque below this counts as equilibrium, Nm.
TOLERANCE = 1e-9
ITERATIONS = 100


def equilibrium(system: System, theta: Array, speed: Array) -> tuple[Array, Array]:
    """Solve for the static deflection under gravity with the motors held at `theta`.

    Parameters
    ----------
    theta : (n,)
        Motor angles, rad.
    speed : (2n,)
        Regularisation speeds of friction, rad/s (friction is zero at rest).

    Returns
    -------
    x, tau_m
        Generalized coordinates (dof,) and the torque (n,) that holds the motors, Nm.

    Raises
    ------
    SimulationError
        If there is no equilibrium nearby.
    """
    n, dof = system.n, system.dof
    motor = slice(n, 2 * n) if dof > n else slice(0, n)
    free = np.array([k for k in range(dof) if not motor.start <= k < motor.stop], dtype=int)
    x = np.zeros(dof)
    x[:n] = x[motor] = theta
    rest, z = np.zeros(dof), np.zeros(system.states)
    given = (system.equations.nominal, system.effect_set.numbers(), speed)
    torque = np.array(system.balance(x, rest, z, *given)).ravel()
    for _ in range(ITERATIONS):
        if np.abs(torque[free]).max(initial=0.0) < TOLERANCE * (1.0 + np.abs(torque).max()):
            return x, torque[motor]
        slope = np.array(system.stiffness_of_balance(x, rest, z, *given))[np.ix_(free, free)]
        change = np.linalg.lstsq(slope, -torque[free], rcond=None)[0]
        x, torque = _descend(system, x, torque, free, change, given)
    worst = system.equations.robot.joint_names[int(np.abs(torque[:n]).argmax())]
    raise SimulationError(
        f"no static equilibrium was found with the motors at {np.array2string(theta, precision=3)} rad: "
        f"{np.abs(torque[free]).max():.3g} Nm remain, most at {worst}",
        "Check stiffness, masses and the effects' parameters.",
    )


def _descend(
    system: System, x: Array, torque: Array, free: Array, change: Array, given: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """Take the longest of the halved Newton steps that makes the residual smaller."""
    rest, z = np.zeros(system.dof), np.zeros(system.states)
    size = np.abs(torque[free]).max()
    for halvings in range(20):
        trial = x.copy()
        trial[free] += change / 2**halvings
        found = np.array(system.balance(trial, rest, z, *given)).ravel()
        if np.abs(found[free]).max() < size:
            return trial, found
    return trial, found
