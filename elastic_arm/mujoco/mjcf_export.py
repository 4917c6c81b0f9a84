"""A user's own MJCF with the numbers of a corrected arm; everything else stays as it was."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue, EffectInstance
from elastic_arm.errors import RobotError
from elastic_arm.formatting import JointUnits
from elastic_arm.mujoco.changed_numbers import (
    Change,
    Deviations,
    body_after,
    differs,
    inertial_change,
    joint_changes,
    six,
    text_of,
)
from elastic_arm.mujoco.elements import RIGID, delayed, motor_attributes, sharp
from elastic_arm.mujoco.left_out import Left, Motion, left_effects, left_numbers
from elastic_arm.mujoco.mjcf_file import ShapedMjcf
from elastic_arm.mujoco.stand_ins import ALONE, MARK, explained, stood_in
from elastic_arm.mujoco.stated_arm import StatedArm, stated_arm
from elastic_arm.robot import Inertia, Joint, JointController, Robot
from elastic_arm.robot.kinematics import moved
from elastic_arm.robot.mjcf import MjcfArm, engine, open_mjcf, read_mjcf
from elastic_arm.robot.mjcf.drives import drives_of, motor_friction, motor_inertia_and_damping
from elastic_arm.robot.mjcf.engine import saved
from elastic_arm.robot.parts import located, placed
from elastic_arm.robot.urdf_tree import Chain

# What is read back from a written file is what was meant, to this share: nine digits are written.
READ_BACK = 1e-6
UNROLLED = (
    "the file is as saved by MuJoCo, without your layout: bodies of the arm come"
    " from <attach>, <replicate> or a URDF"
)
_NEW = (
    "only a new file (without --base) can represent it; elastic_arm.mujoco.attach"
    " adds its law to this file"
)
_ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")


_ALL_TURN = JointUnits(())


@dataclass(frozen=True)
class Exported:
    """What an export wrote."""

    files: tuple[Path, ...]  # the file, and copies of what it includes where that changed
    changes: tuple[Change, ...]  # numbers before and after
    left: tuple[Left, ...]  # what the file does not hold of the arm
    notes: tuple[str, ...] = ()  # what else is to be known of the file
    units: JointUnits = _ALL_TURN  # at the arm's joints
    stand_ins: tuple[
        str, ...
    ] = ()  # which numbers stand for laws that the file has none for, a sentence each


def require_same_joints(robot: Robot, base: Robot, path: Path) -> None:
    """Refuse an arm that the base does not describe."""
    if robot.joint_names != base.joint_names:
        raise RobotError(
            f"{path} has the joints {', '.join(base.joint_names)}, the arm"
            f" {', '.join(robot.joint_names)}",
            "Give the file that the arm was read from, with the same --chain",
        )
    if robot.elastic:
        raise RobotError(
            f"{robot.name} has transmissions, but {path} has none",
            "Export it without --base, as a new file",
        )


def export_mjcf(
    robot: Robot,
    base: Path,
    out: Path,
    *,
    chain: Chain | None = None,
    at: str | None = None,
    deviations: Deviations | None = None,
    catalogue: Catalogue | None = None,
    motion: Motion | None = None,
    alone: bool = False,
) -> Exported:
    """Write an MJCF with the numbers of an arm: inertials, armature, damping, friction loss,
    gravity, sensor delays.

    The corrected arm, with its effects, has the joints and frames of the user's file `base`, from
    which it was read by `chain` and `at`; `deviations` of estimates go into the table. Friction
    laws that no number states have friction loss and damping in their place, nearest over `motion`,
    the recording's, or over a swing. `alone` marks a file whose numbers were refined without laws,
    on which none act. Raises a RobotError if the arm is another one, its numbers are
    of no physical body, or the file's elements cannot be found.
    """
    arm = open_mjcf(base, chain, at)
    require_same_joints(robot, arm.robot, base)
    before = stated_arm(arm.robot, catalogue, base=arm.robot.base_placement)
    after = stated_arm(robot, catalogue, base=arm.robot.base_placement)
    stated = [instance.to_dict() for instance, _ in before.left]
    # What the base states by other numbers, such as gravcomp, stays as it is.
    lacking = [(one, _NEW if one.effect.id in RIGID else reason) for one, reason in after.left]
    lacking = [(one, reason) for one, reason in lacking if one.to_dict() not in stated]
    after, stand_ins = stood_in(after, robot, lacking, motion)
    with located(f"{base}: "):
        file = ShapedMjcf(base)
        unrolled = _carriers(file, arm) is None
        if unrolled:
            file = ShapedMjcf(base, saved(base))
        document = _Document(arm, file, before, after)
        changes = [*document.change(deviations), *document.controllers(robot)]
        marks = [one.numeric for one in stand_ins]
        document.mark([*marks, {"name": ALONE, "data": "1"}] if alone else marks)
        files = document.file.write(out)
        _check(out, chain, at, after)
        written = read_mjcf(out, chain, at)
    lacking = explained(lacking, stand_ins)
    left = [
        *left_effects(robot, (*lacking, *document.left), catalogue),
        *_controllers(robot, written),
    ]
    notes = (UNROLLED,) if unrolled else ()
    return Exported(
        tuple(files),
        tuple(changes),
        tuple(left),
        notes,
        robot.units,
        tuple(one.words(robot) for one in stand_ins),
    )


def _controllers(robot: Robot, base: Robot) -> Iterator[Left]:
    """Yield the controllers that a file's actuators do not state, to nine digits; these stay as
    they are."""
    own = {joint.name: joint.controller for joint in base.joints}
    other = [
        joint
        for joint in robot.joints
        if joint.controller and not _alike(joint.controller, own[joint.name])
    ]
    for joint in other:
        yield from left_numbers(
            robot.with_(joints=(joint,)), "the actuators of the file are unchanged"
        )


def _alike(one: JointController, other: JointController | None) -> bool:
    if other is None:
        return False
    numbers = ("kp", "kd", "ki", "delay", "torque", "stall", "sag")
    if other.firmware_gain is None:  # the gains are those of the recordings' one
        one = replace(one, firmware_gain=None)
    same = replace(one, **{name: getattr(other, name) for name in numbers}) == other
    pairs = [
        [np.inf if (v := getattr(drive, k)) is None else v for drive in (one, other)]
        for k in numbers
    ]
    return same and all(np.isclose(a, b, rtol=READ_BACK, atol=0.0) for a, b in pairs)


def _carriers(file: ShapedMjcf, arm: MjcfArm) -> list[Any] | None:
    """Return the elements of the bodies that carry the arm's joints, or None where one stands
    nowhere in the file."""
    model = arm.model
    places = [int(model.jnt_bodyid[joint]) for joint in arm.chain.joints]
    return file.lines_of([model.body(place).name for place in places], places, model.nbody - 1)


class _Document:
    """One pass over the trees of a file."""

    def __init__(self, arm: MjcfArm, file: ShapedMjcf, before: StatedArm, after: StatedArm) -> None:
        self.arm = arm
        self.file = file
        self.before = before
        self.after = after
        self.left: list[tuple[EffectInstance, str]] = []
        elements = _carriers(file, arm)
        if elements is None:
            raise RobotError(
                "some bodies of the arm have no name and no line in the file",
                "Name them in the file",
            )
        self._elements = elements
        self._carriers = [int(arm.model.jnt_bodyid[joint]) for joint in arm.chain.joints]

    def change(self, deviations: Deviations | None) -> list[Change]:
        changes = list(self._joints(deviations))
        for i in range(self.arm.robot.n):
            if differs(self.before.links[i], self.after.links[i]):
                changes += self._inertial(i)
        if not np.allclose(self.before.gravity, self.after.gravity, rtol=0.0, atol=1e-9):
            self._gravity()
            old = tuple(map(float, self.before.gravity))
            new = tuple(map(float, self.after.gravity))
            changes.append(Change("option", "gravity", "m/s²", old, new))
        return changes

    def _joints(self, deviations: Deviations | None) -> list[Change]:
        robot = self.arm.robot
        changes = []
        for (i, field), change in joint_changes(robot, self.before, self.after, deviations).items():
            if field == "delay":
                if self._delay(i):
                    changes.append(change)
                else:
                    reason = "the file has no jointactuatorfrc sensor of this joint"
                    name = self.arm.robot.joint_names[i]
                    late = [(one, reason) for one in self.after.delays if one.joint in (name, None)]
                    self.left += [one for one in late if one not in self.left]
                continue
            element = self._joint_element(i)
            from_actuator = self._from_actuator(i, field)
            value = change.after[0] - from_actuator
            if field == "zero":
                # The position at which the model is drawn: what is read there grows by the offset.
                own = float(self.arm.model.qpos0[self.arm.positions[i]])
                change = replace(change, before=(own,), after=(own + value,))
                value += own
            if field in ("rest", "zero"):
                value *= self._angle(i)
            elif value < 0.0:
                raise RobotError(
                    f"{change.number} of {change.element} would be smaller than the part of its"
                    f" actuator ({from_actuator:g})",
                    "Move armature and damping from the actuator to the joint in the file",
                )
            self.file.set(element, **{change.number: text_of(value)})
            changes.append(change)
            if field == "friction_loss" and change.before == (0.0,):
                changes += self._sharp(element, change.element)
        return changes

    def mark(self, marks: Sequence[Mapping[str, str]]) -> None:
        """Note which numbers stand for laws, in the place of earlier notes."""
        for element in list(self.file.elements("numeric")):
            if (element.get("name") or "").startswith((MARK, ALONE)):
                self.file.remove(element)
        if marks:
            custom = self.file.insert_first(self.file.root, "custom")
            for one in marks:
                self.file.set(self.file.insert_first(custom, "numeric"), **one)

    def controllers(self, robot: Robot) -> Iterator[Change]:
        """Change gains, delays and limits of <position> elements; other actuators stay as they
        are."""
        for old, new in zip(self.arm.robot.joints, robot.joints, strict=True):
            before = old.controller
            after = new.controller
            if before is not None and after is not None and before.stall is not None:
                yield from self._motor(old, before, after)
                continue
            elements = [e for e in self.file.elements("position") if e.get("joint") == old.name]
            if before is None or after is None or _alike(after, before) or len(elements) != 1:
                continue
            (drive,) = drives_of(self.arm.model, self._id(old.name))
            squared = float(self.arm.model.actuator_gear[drive, 0]) ** 2
            values = {"kp": (before.kp, after.kp, squared), "kv": (before.kd, after.kd, squared)}
            values["delay"] = (before.delay, after.delay, 1.0)
            ratio = any(e.get("dampratio") for e in self.file.elements("position"))
            for number, unit in (("kp", "Nm/rad"), ("kv", "Nm s/rad"), ("delay", "s")):
                own, wanted, gear = values[number]
                same = np.isclose(own, wanted, rtol=READ_BACK, atol=0.0)
                # MuJoCo makes kv of a dampratio, kp and masses, which change.
                if not same or (ratio and number == "kv"):
                    self.file.set(elements[0], **{number: text_of(wanted / gear)})
                    if ratio:
                        self.file.set(elements[0], dampratio=None)
                if not same:
                    yield Change(old.name, number, old.unit(unit), (own / gear,), (wanted / gear,))
            if after.torque is not None and after.torque != before.torque:
                most = after.torque / abs(float(self.arm.model.actuator_gear[drive, 0]))
                self.file.set(elements[0], forcerange=text_of(-most, most))
                old_limit = () if before.torque is None else (before.torque / after.torque * most,)
                yield Change(old.name, "forcerange", old.unit("Nm"), old_limit, (most,))
            if after.delay and after.delay != before.delay:
                self._set_delay(elements[0], after.delay)

    def _motor(
        self, joint: Joint, before: JointController, after: JointController
    ) -> Iterator[Change]:
        """Change the constants of a <dcmotor> with firmware."""
        elements = [e for e in self.file.elements("dcmotor") if e.get("joint") == joint.name]
        if after.stall is None or not after.kd or _alike(after, before) or len(elements) != 1:
            return
        (drive,) = drives_of(self.arm.model, self._id(joint.name))
        gear = float(self.arm.model.actuator_gear[drive, 0])
        self.file.set(elements[0], nominal=None, **motor_attributes(after, gear))
        for number, unit in (("kp", "Nm/rad"), ("kd", "Nm s/rad"), ("stall", "Nm")):
            own = getattr(before, number)
            wanted = getattr(after, number)
            if not np.isclose(own, wanted, rtol=READ_BACK, atol=0.0):
                yield Change(joint.name, number, joint.unit(unit), (own,), (wanted,))
        if after.torque is not None and after.torque != before.torque:
            most = after.torque / abs(gear)
            self.file.set(elements[0], saturation=text_of(most, 0.0, 0.0))
            limit = () if before.torque is None else (before.torque,)
            yield Change(joint.name, "torque", joint.unit("Nm"), limit, (after.torque,))
        if after.delay != before.delay:
            self._set_delay(elements[0], after.delay)
            yield Change(joint.name, "delay", "s", (before.delay,), (after.delay,))

    def _set_delay(self, element: Any, delay: float) -> None:
        """Set the delay of an actuator, s."""
        between = {} if element.get("interp") else {"interp": "linear"}
        late = delayed(delay, float(self.arm.model.opt.timestep))
        self.file.set(element, **late, **between)

    def _sharp(self, element: Any, name: str) -> list[Change]:
        """Let new friction loss turn over with the velocity: by MuJoCo's default it does some 10 ms
        earlier."""
        if element.get("solreffriction") is not None:
            return []
        own = tuple(
            float(v)
            for v in self.arm.model.dof_solref[int(self.arm.model.jnt_dofadr[self._id(name)])]
        )
        new = (2.0 * float(self.arm.model.opt.timestep), 1.0)
        if not 0.0 < new[0] < own[0]:
            return []
        self.file.set(element, solreffriction=sharp(float(self.arm.model.opt.timestep)))
        return [Change(name, "solreffriction", "s, 1", own, new)]

    def _angle(self, i: int) -> float:
        """Return what a joint's angle in rad, or travel in m, is multiplied by in the file."""
        stated = [
            element.get("angle")
            for element in self.file.elements("compiler")
            if element.get("angle")
        ]
        return 1.0 if self.arm.robot.joints[i].prismatic or "radian" in stated else 180.0 / np.pi

    def _id(self, joint: str) -> int:
        return self.arm.chain.joints[self.arm.robot.joint_names.index(joint)]

    def _from_actuator(self, i: int, field: str) -> float:
        model = self.arm.model
        joint = self.arm.chain.joints[i]
        dof = int(model.jnt_dofadr[joint])
        armature, damping = motor_inertia_and_damping(model, joint)
        own = {
            "armature": armature - float(model.dof_armature[dof]),
            "damping": damping - float(model.dof_damping[dof]),
            "friction_loss": motor_friction(model, joint)[0],
        }
        return own.get(field, 0.0)

    def _joint_element(self, i: int) -> Any:
        joint = self.arm.chain.joints[i]
        body = self._carriers[i]
        elements = self.file.children(self._elements[i], "joint")
        k = joint - int(self.arm.model.body_jntadr[body])
        if k >= len(elements) or elements[k].get("name") not in (
            None,
            self.arm.robot.joint_names[i],
        ):
            raise RobotError(
                f"joint {self.arm.robot.joint_names[i]!r} has no line of its own in the file",
                "Give each joint of the arm a line in its body",
            )
        return elements[k]

    def _delay(self, i: int) -> bool:
        """Delay the sensor of a joint's motor torque; without one the recording alone is late."""
        delay = self.after.joints[i].delay
        name = self.arm.robot.joint_names[i]
        for element in self.file.elements("jointactuatorfrc"):
            if element.get("joint") == name:
                self.file.set(element, **delayed(delay, float(self.arm.model.opt.timestep)))
                return True
        return False

    def _inertial(self, i: int) -> list[Change]:
        model = self.arm.model
        body = self._carriers[i]
        name = self.arm.robot.joints[i].link_name
        if self._carriers[i + 1 : i + 2] == [body]:
            raise RobotError(
                f"{name} is not a separate body in the file", "Give each joint its own body"
            )
        if any(e.get("inertiafromgeom") == "true" for e in self.file.elements("compiler")):
            raise RobotError(
                "its compiler takes all inertia from geoms (inertiafromgeom)",
                'Set inertiafromgeom="auto"',
            )
        own = own_inertia(model, body)
        new = body_after(own, self.before.links[i], self.after.links[i], name)
        element = self._elements[i]
        inertials = self.file.children(element, "inertial")
        inertial = inertials[0] if inertials else self.file.insert_first(element, "inertial")
        values: dict[str, str | None] = dict.fromkeys(("diaginertia", *_ORIENTATIONS))
        values["pos"] = text_of(*new.com)
        values["mass"] = text_of(new.mass)
        values["fullinertia"] = text_of(*six(new))
        self.file.set(inertial, **values)
        return inertial_change(name, own, new)

    def _gravity(self) -> None:
        options = [
            element
            for element in self.file.elements("option")
            if element.getparent().tag != "default"
        ]
        option = options[0] if options else self.file.insert_first(self.file.root, "option")
        self.file.set(option, gravity=text_of(*self.after.gravity))


def own_inertia(model: Any, body: int) -> Inertia:
    """Return a body's inertia in its own frame."""
    rotation = np.empty(9)
    engine().mju_quat2Mat(rotation, model.body_iquat[body])
    principal = np.diag(np.array(model.body_inertia[body], dtype=float))
    return moved(
        Inertia(float(model.body_mass[body]), inertia=principal),
        placed(rotation, model.body_ipos[body]),
    )


def _check(out: Path, chain: Chain | None, at: str | None, wanted: StatedArm) -> None:
    """Read the written file back and compare torques with those that were meant."""
    again = open_mjcf(out, chain, at)
    meant = again.robot.with_(
        gravity=wanted.gravity,
        joints=tuple(
            replace(joint, link=wanted.links[i], armature=wanted.joints[i].armature)
            for i, joint in enumerate(again.robot.joints)
        ),
    )
    q, dq, ddq = np.random.default_rng(0).uniform(-2.0, 2.0, (3, 10, again.robot.n))
    read = build_model(again.robot, engine="numpy").inverse_dynamics(q, dq, ddq)
    asked = build_model(meant, engine="numpy").inverse_dynamics(q, dq, ddq)
    joints = stated_arm(again.robot).joints
    found = [(j.damping, j.friction_loss, j.stiffness, j.rest) for j in joints]
    meant_to_be = [(j.damping, j.friction_loss, j.stiffness, j.rest) for j in wanted.joints]
    if np.abs(read - asked).max() > READ_BACK * np.abs(asked).max() or not np.allclose(
        found, meant_to_be, rtol=READ_BACK
    ):
        raise RobotError(
            "the written file does not represent the intended arm: some default or"
            " attribute overrides it",
            "Please report it with the file",
        )
