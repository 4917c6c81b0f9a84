"""Laws that an MJCF cannot state, applied in MuJoCo by its callback for passive forces.

The laws are those of the effects' own files. Dry friction is regularised over the speed that the
time step of the model can follow. MuJoCo has one callback per process: all attached arms share it,
and a callback that was set before is called first.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.effects import Catalogue, EffectInstance, StructuralEffect, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.errors import EffectError, RobotError
from elastic_arm.mujoco.carried import carried
from elastic_arm.mujoco.elements import DEFLECTION, Elements
from elastic_arm.mujoco.stand_ins import ALONE, take_stand_in_away
from elastic_arm.mujoco.stated_arm import acts_by_law, stated_arm
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.mjcf import engine
from elastic_arm.robot.mjcf.drives import passive
from elastic_arm.simulation.assembly import law_rows
from elastic_arm.simulation.simulator import SIGN_SPEED, STEEPEST

_attached: dict[int, Attachment] = {}
_before: list[Any] = []  # the callback that was set before


class Attachment:
    """Laws (`instances`) that act on a compiled `MjModel`; a context manager that detaches them.

    stated: effects that the model already contains, which other laws may depend on.

    Raises a RobotError if the model lacks a joint of the arm.
    """

    def __init__(
        self,
        model: Any,
        robot: Robot,
        instances: Sequence[EffectInstance],
        stated: Sequence[EffectInstance] = (),
    ) -> None:
        self.model = model
        self.robot = robot
        self.instances = tuple(instances)
        self._theta, self._wound = _addresses(model, robot)
        equations = ArmEquations(robot)
        # The contribution of all effects minus that of the stated ones: a law may scale friction,
        # or depend on tau_J.
        self._acting = (*self.instances, *stated)
        self._sets = [
            EffectSet(one, robot) for one in ((self._acting, stated) if stated else (self._acting,))
        ]
        self._laws = [
            (law_rows(equations, one), (equations.nominal, one.numbers())) for one in self._sets
        ]
        self._states = sum(int(one.z.numel()) for one in self._sets)
        # Motors without commands: their torque is friction and does not drive the joint.
        joints = enumerate(zip(model.actuator_trntype, model.actuator_trnid, strict=True))
        self._passive = [
            (k, int(model.jnt_dofadr[joint]))
            for k, (kind, (joint, _)) in joints
            if passive(model, k) and int(kind) == int(engine().mjtTrn.mjTRN_JOINT)
        ]
        self._memory: dict[int, tuple[float, Array, Array]] = {}
        self._speed = np.full(2 * robot.n, SIGN_SPEED)
        self._speed = self._followable()
        self._stood_in = np.array(model.dof_frictionloss), np.array(model.dof_damping)
        self._take_stand_ins_away()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.detach()

    def detach(self) -> None:
        """Remove the laws from the model."""
        self.model.dof_frictionloss[:], self.model.dof_damping[:] = self._stood_in
        _attached.pop(self.model._address, None)
        if not _attached:
            engine().set_mjcb_passive(_before.pop() if _before else None)

    def _take_stand_ins_away(self) -> None:
        """Take the friction that approximates laws from the model: the laws act from now on."""
        robot = self.robot
        laws = [one for one in self.instances if one.effect.friction]
        if robot.elastic or not laws:
            return
        for i in {k for law in laws for k in law.joint_indices(robot)}:
            take_stand_in_away(self.model, robot.joint_names[i], int(self._theta[1][i]))

    def act(self, data: Any) -> None:
        """Add the forces of the laws to the passive forces of a state."""
        time = float(data.time)
        z = self._state(data)
        rows, rates = self._evaluate(data, z)
        if self._states:
            self._memory[data._address] = (time, z, rates)
        dofs = self._theta[1]
        n = self.robot.n
        if not self.robot.elastic:
            data.qfrc_passive[dofs] -= rows
            return
        # q is the sum of both joints, so a torque on the link acts on both.
        data.qfrc_passive[dofs] -= rows[:n] + rows[n : 2 * n]
        data.qfrc_passive[self._wound[1]] -= rows[:n]

    def _evaluate(self, data: Any, z: Array) -> tuple[Array, Array]:
        positions, dofs = self._theta
        wound, wound_dofs = self._wound
        values = [
            np.array(data.qpos[positions]),
            np.array(data.qvel[dofs]),
            np.array(data.qacc[dofs]),
        ]
        if self.robot.elastic:
            apart = (data.qpos[wound], data.qvel[wound_dofs], data.qacc[wound_dofs])
            values = [
                np.concatenate([own + more, own]) for own, more in zip(values, apart, strict=True)
            ]
        torque = self._torque(data)
        rows = np.zeros(self.robot.n * (2 if self.robot.elastic else 1))
        rates = []
        first = 0
        for sign, effects, (law, numbers) in zip((1.0, -1.0), self._sets, self._laws, strict=False):
            last = first + int(effects.z.numel())
            added, changing = law(*values, z[first:last], torque, *numbers, self._speed)
            rows = rows + sign * np.array(added).ravel()
            first = last
            rates.append(np.array(changing).ravel())
        return rows, np.concatenate(rates)

    def _torque(self, data: Any) -> Array:
        """Return the motor torques (n,), Nm; for a rigid arm those behind the gears, on which
        friction by load depends."""
        dofs = self._theta[1]
        if not self.robot.elastic:
            return carried(self.model, data, dofs)
        torque = data.qfrc_actuator + data.qfrc_applied
        for k, dof in self._passive:
            torque[dof] -= float(self.model.actuator_gear[k, 0]) * float(data.actuator(k).force[0])
        return torque[dofs]

    def _state(self, data: Any) -> Array:
        """Return the internal states at the time of `data`, by an explicit Euler step from the last
        evaluation."""
        known = self._memory.get(data._address)
        if known is None or not known[0] <= data.time <= known[0] + 1.0:
            return np.zeros(self._states)  # a new or reset motion
        time, z, rates = known
        return z + (float(data.time) - time) * rates

    def _followable(self) -> Array:
        """Return the speeds (2n,) of regularised signs: `friction step / inertia` or more."""
        mj = engine()
        model = self.model
        n = self.robot.n
        data = mj.MjData(model)
        mj.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mj.mj_fullM(model, data, full)
        least = np.diag(full)
        found = self._speed.copy()
        for k in range(2 * n):
            i = k % n
            side = "link" if k < n else "motor"
            mass = least[
                (self._wound if side == "link" and self.robot.elastic else self._theta)[1][i]
            ]
            dry = [e for e in self._acting if i in e.joint_indices(self.robot) and side in e.sides]
            torque = sum(
                abs(float(v))
                for e in dry
                for p, v in e.numbers.items()
                if e.effect.parameter(p).unit == "Nm"
            )
            found[k] = max(found[k], torque * float(model.opt.timestep) / float(mass) / STEEPEST)
        return found


def attach(
    model: Any,
    robot: Robot | str | Path,
    *,
    chain: str | None = None,
    catalogue: Catalogue | None = None,
) -> Attachment:
    """Apply the laws of an arm's effects in a MuJoCo model, except those that its file states.

    The model is the compiled `MjModel` of a file by `elastic-arm export`, or by `diagnose` together
    with robot.yaml. The arm has its effects, for example diagnosis/robot.yaml; `chain` selects the
    arm in a URDF or MJCF. The result has `detach()`, and the acting effects as `instances`. Raises
    an EffectError if an effect does not act by a law, and a RobotError if the model lacks a joint
    of the arm, or its numbers were refined without the laws.
    """
    mj = engine()
    if mj.mj_name2id(model, mj.mjtObj.mjOBJ_NUMERIC, ALONE) >= 0:
        raise RobotError(
            "the numbers of this file were refined without the laws, which would act twice",
            "Attach them to the file that `elastic-arm export diagnosis/robot.yaml --base YOUR.xml"
            " --out FILE` writes.",
        )
    arm = robot if isinstance(robot, Robot) else load_robot(robot, chain)
    if (again := _attached.get(model._address)) is not None:
        again.detach()
    left = Elements(arm, stated_arm(arm, catalogue), float(model.opt.timestep)).left_by(model)
    structural = [e for e in left if isinstance(e.effect, StructuralEffect)]
    if structural:
        raise EffectError(
            f"{structural[0].effect.id} changes the structure of the arm",
            "Omit it, or model it in the MJCF.",
        )
    known = [e for e in robot_effects(arm, catalogue) if e.effect.friction or "drive" in e.sides]
    stated = [e for e in known if e not in left and acts_by_law(e.effect)]
    instances = [e for e in left if acts_by_law(e.effect)]
    attachment = Attachment(model, arm, instances, stated if instances else ())
    if not _attached:
        earlier = mj.get_mjcb_passive()
        if earlier is not None:
            _before.append(earlier)
        mj.set_mjcb_passive(_passive)
    _attached[model._address] = attachment
    return attachment


def _passive(model: Any, data: Any) -> None:
    for earlier in _before:
        earlier(model, data)
    attachment = _attached.get(model._address)
    if attachment is not None:
        attachment.act(data)


Addresses = tuple[Indices, Indices]


def _addresses(model: Any, robot: Robot) -> tuple[Addresses, Addresses]:
    """Return the indices of motor joints, and of the joints of deflections, in qpos and qvel."""
    mj = engine()
    found = []
    for end in ("", DEFLECTION) if robot.elastic else ("",):
        ids = [
            mj.mj_name2id(model, mj.mjtObj.mjOBJ_JOINT, f"{name}{end}")
            for name in robot.joint_names
        ]
        missing = [f"{name}{end}" for name, k in zip(robot.joint_names, ids, strict=True) if k < 0]
        if missing:
            raise RobotError(
                f"the model has no joint {', '.join(missing)}",
                "Load the file that elastic-arm export wrote for this arm",
            )
        places = (model.jnt_qposadr[ids], model.jnt_dofadr[ids])
        found.append((np.asarray(places[0], dtype=np.intp), np.asarray(places[1], dtype=np.intp)))
    return found[0], found[-1]
