"""What wrong numbers of a transmission share: the torque that the nominal number makes, times what it is off."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Law
from elastic_arm.effects.motion import Contribution, SymbolicMotion


def scaled(ratio: str, side: str, torque: Callable[[SymbolicMotion, int], ca.SX]) -> Law:
    """Return the law (ratio - 1) times a torque of the nominal transmission."""

    def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
        if side == "drive":
            motion.gear(i)
        added: dict[str, Any] = {side: (p[ratio] - 1.0) * torque(motion, i)}
        return motion.at(i, **added)

    return law
