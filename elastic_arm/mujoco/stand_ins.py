"""Dry and viscous friction that approximates a friction law that a file cannot state.

    min over c, d of  sum over t of (F(t) - c sign(w(t)) - d w(t))²
    with              friction loss + c >= 0, d >= 0

F is the torque of the laws over a motion: the recorded one if there is one, otherwise the swing of
:mod:`elastic_arm.mujoco.left_out`. Damping never decreases, because friction would then fall beyond
the speeds of the motion.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from elastic_arm.arrays import Array, rms
from elastic_arm.effects import EffectInstance
from elastic_arm.mujoco.changed_numbers import text_of
from elastic_arm.mujoco.left_out import Motion, Swing
from elastic_arm.mujoco.stated_arm import Lacking, StatedArm, number
from elastic_arm.robot import Robot
from elastic_arm.robot.mjcf import engine

# Name of the <numeric> of a joint: `attach` removes its numbers when the laws themselves act.
MARK = "in_place_of_friction_laws:"
# Name of the <numeric> of a file whose numbers were refined without the laws, which then must not
# act.
ALONE = "refined_without_laws"
# Smallest share of a law that numbers approximate; below is rounding.
NOTHING = 1e-6


@dataclass(frozen=True)
class StandIn:
    """Numbers of a joint that approximate laws."""

    joint: str
    laws: tuple[EffectInstance, ...]
    friction_loss: float  # Nm added
    damping: float  # Nm s/rad added
    left: float  # root mean square of the remaining torque, Nm
    whole: float  # root mean square of the laws, Nm
    recorded: bool  # whether the motion was recorded

    @property
    def numeric(self) -> dict[str, str]:
        """Attributes of the <numeric> with the numbers that approximate laws."""
        return {"name": f"{MARK}{self.joint}", "data": text_of(self.friction_loss, self.damping)}

    def words(self, robot: Robot) -> str:
        """Return the approximation as a sentence."""
        units = robot.units
        torque = units.at(self.joint, "Nm")
        rate = units.at(self.joint, "Nm s/rad")
        laws = " and ".join(_named(law, torque) for law in self.laws)
        added = (
            f"{self.friction_loss:+.3g} {torque} of friction loss and {self.damping:+.3g} {rate} of"
            " damping"
        )
        over = "the motion of the recording" if self.recorded else "an oscillation at 1 rad/s"
        missing = f"{self.left:.2g} of {self.whole:.2g} {torque} rms remain"
        return (
            f"{laws} of {self.joint} has no number in the file: {added} approximate it"
            f" over {over}; {missing}"
        )


def stood_in(
    arm: StatedArm, robot: Robot, lacking: Sequence[Lacking], motion: Motion | None = None
) -> tuple[StatedArm, tuple[StandIn, ...]]:
    """Return the numbers of a rigid arm with approximations of the friction laws that it lacks."""
    if robot.elastic:
        return arm, ()
    found = tuple(
        _stand_ins(arm, robot, [law for law, _ in lacking if law.effect.friction], motion)
    )
    for one in found:
        i = robot.joint_names.index(one.joint)
        arm = arm.with_joint(i, friction_loss=one.friction_loss, damping=one.damping)
    return arm, found


def take_stand_in_away(model: Any, joint: str, dof: int) -> Array:
    """Take the friction that approximates a joint's laws from a compiled model.

    Returns its friction loss and damping (2,), a view into the model; zeros if it has none.
    """
    mj = engine()
    numeric = mj.mj_name2id(model, mj.mjtObj.mjOBJ_NUMERIC, f"{MARK}{joint}")
    if numeric < 0:
        return np.zeros(2)
    begin = int(model.numeric_adr[numeric])
    stand_in: Array = model.numeric_data[begin : begin + 2]
    model.dof_frictionloss[dof] = max(0.0, float(model.dof_frictionloss[dof] - stand_in[0]))
    model.dof_damping[dof] = max(0.0, float(model.dof_damping[dof] - stand_in[1]))
    return stand_in


def explained(lacking: Sequence[Lacking], found: Sequence[StandIn]) -> list[Lacking]:
    """Return the laws that an arm lacks, with other reasons for approximated ones."""
    places: Mapping[int, StandIn] = {id(law): one for one in found for law in one.laws}
    reasons = []
    for law, reason in lacking:
        stands = places.get(id(law))
        words = f"friction loss and damping approximate it; {reason}" if stands else reason
        reasons.append((law, words))
    return reasons


def _stand_ins(
    arm: StatedArm, robot: Robot, laws: Sequence[EffectInstance], motion: Motion | None
) -> Iterator[StandIn]:
    swing = Swing(robot, motion)
    for i, name in enumerate(robot.joint_names):
        own = tuple(law for law in laws if i in law.joint_indices(robot))
        if not own:
            continue
        here = [replace(law, joint=name) for law in own]
        torque = swing.of_effects(here)[:, i]
        whole = float(rms(torque, None))
        speed: Array = swing.motion[1][:, i]
        stated = arm.joints[i]
        columns = np.stack([np.sign(speed), speed], axis=1)
        least = np.array([-max(0.0, stated.friction_loss), 0.0])
        fit = lsq_linear(columns, torque, bounds=(least - NOTHING, np.inf))
        dry, viscous = (float(v) for v in np.maximum(fit.x, least))
        left = float(rms(torque - columns @ (dry, viscous), None))
        if whole - left > NOTHING * whole:
            yield StandIn(name, own, dry, viscous, left, whole, motion is not None)


def _named(law: EffectInstance, unit: str) -> str:
    name = law.effect.id.replace("_", " ")
    return f"{name} ({number(law, 'torque'):.3g} {unit})" if "torque" in law.parameters else name
