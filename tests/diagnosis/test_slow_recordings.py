"""Recordings of 100 and 250 Hz, in whose band the smoother takes a part of what the residuals hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot
from tests.helpers.hidden_arms import recordings


def thinned(recording: Recording, every: int) -> Recording:
    """Return what a recorder `every` times as slow has: angles at its stamps, torques as means around them."""
    mean = np.full(every + 1, 1.0 / every)
    mean[[0, -1]] *= 0.5
    kept = slice(every // 2, -(every // 2), every)

    def slower(side: Side) -> Side:
        effort = np.array([np.convolve(torque, mean, mode="valid") for torque in side.effort.T]).T[::every]
        return replace(
            side,
            stamp_ns=side.stamp_ns[kept],
            position=side.position[kept],
            velocity=side.velocity[kept],
            effort=effort[: len(side.position[kept])],
        )

    return replace(recording, link=slower(recording.link), motor=slower(recording.motor))


@pytest.mark.slow(seconds=10)
@pytest.mark.parametrize("every", [10, 4])
@pytest.mark.parametrize("joint", [1, 2])
def test_dry_friction_is_dry_friction_at_low_rates(every: int, joint: int) -> None:
    """Coulomb friction is no friction that levels off, though its jumps are sampled at 100 or 250 Hz."""
    fit, judge = (thinned(r, every) for r in recordings(("coulomb_friction", joint, "motor", "torque", 6.0)))
    found = diagnose([fit], Question(load_robot(None)), [judge])
    ((cause, where, torque),) = [(c.effect, c.joint, c.parameters["torque"]) for c in found.causes]
    assert (found.verdict, cause, where) == ("explained", "coulomb_friction", f"joint_{joint + 1}")
    assert torque.value == pytest.approx(6.0, abs=3.0 * torque.std)
