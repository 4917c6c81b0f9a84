"""The numbers of a corrected servo arm, refined by an output error: what is played back is what is
minimised.

    min over x of  sum over joints and samples of |q(t_k; x) - q_k|² / s_j²
                   + sum of 5 log(1 + ((x - m) / p)² / 4)

x are numbers of the arm, m and p their posterior means and deviations (with the tails of Student's
t, as causes may have been missed), q the angles that MuJoCo's servos reach under the commands of
the recordings that were fitted, and s_j the root mean square of a joint's error where the search
is, or what the encoder cannot tell. Gauss-Newton, with differences of simulations as derivatives.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.equations.numbers import RATIO, SCALE
from elastic_arm.errors import RobotError
from elastic_arm.mujoco.changed_numbers import body_after, differs
from elastic_arm.mujoco.closed_loop import play, plays_by_step
from elastic_arm.mujoco.judgement import Judging
from elastic_arm.mujoco.mjcf_export import own_inertia
from elastic_arm.mujoco.stated_arm import stated_arm
from elastic_arm.robot import Robot
from elastic_arm.robot.mjcf import MjcfArm, engine
from elastic_arm.robot.mjcf.drives import drives_of

LEAST = -0.9  # of a ratio less 1
TOLD = 0.98  # of the prior's deviation, beyond which a recording does not tell of a number
LONGEST = 10.0  # s of recordings that are simulated for each number
ROUNDS = 8
TAILS = (
    4.0  # degrees of freedom of Student's t: the posterior is of the sets of causes that were met
)
LITTLE = 0.01  # nats, by which errors fall in a round that is the last
DIFFERENCE = 0.1  # of a number's deviation, over which derivatives are taken
# Effects that are numbers of a joint, and the parameter that is one.
DELAY = "command_delay"
MASSES = ("payload", "load")  # numbers are "payload.mass", "payload.position_x", …
FRICTION = {"coulomb_friction": "torque", "viscous_friction": "coefficient"}


@dataclass(frozen=True)
class Refinable:
    """A number of a corrected arm: a deviation from where it was found."""

    # "scale" of kp and kd, "kd", "armature", "mass" are ratios less 1; "delay" s, "limit" Nm,
    # "com_x" … m, and effects in their units
    what: str
    joint: str | None  # None of all joints
    std: float  # of the posterior
    least: float = -np.inf  # below which no simulator takes it


def refinable(found: Diagnosis) -> tuple[Refinable, ...]:
    """Return the numbers of a diagnosed servo arm that its recordings determine, with their
    posterior deviations."""
    return (
        *_of_description(found),
        *_of_friction(found),
        *_of_masses(found),
        *_of_controllers(found),
    )


def _of_description(found: Diagnosis) -> Iterator[Refinable]:
    ratios = {SCALE: "scale", RATIO: "kd", "rotor_inertia": "armature", "link_mass": "mass"}
    for one in found.imperfections:
        # Gains count in any case: one may stand where another cause was tried, and nothing else
        # tell of it.
        told = one.std < TOLD * one.prior_std or one.what in (SCALE, RATIO)
        if not told or one.std <= 0.0:
            continue
        if one.what in ratios and one.unit == "1" and one.value > 0.0:
            yield Refinable(ratios[one.what], one.joint, one.std / one.value, LEAST)
        elif one.what.startswith("link_com_"):
            yield Refinable(one.what.removeprefix("link_"), one.joint, one.std)


def _of_friction(found: Diagnosis) -> Iterator[Refinable]:
    causes = {
        (cause.effect, cause.joint): cause.parameters
        for cause in found.causes
        if cause.held_as == "effect"
    }
    sizes = {
        place: {name: (e.value, e.std) for name, e in own.items()} for place, own in causes.items()
    }
    for one in found.known:
        stated = {name: (e["value"], e["std"]) for name, e in one["parameters"].items()}
        sizes.setdefault((one["effect"], one["joint"]), stated)
    for (effect, joint), size in sizes.items():
        if effect in FRICTION:
            value, std = size[FRICTION[effect]]
            if std:
                yield Refinable(effect, joint, float(std), -float(value))


def _of_masses(found: Diagnosis) -> Iterator[Refinable]:
    for cause in found.causes:
        if cause.effect in MASSES:
            mass, position = cause.parameters["mass"], cause.parameters["position"]
            joint = cause.joint or found.joints[-1]
            yield Refinable(f"{cause.effect}.mass", joint, float(mass.std), -float(mass.value))
            for axis, std in zip("xyz", position.std, strict=True):
                yield Refinable(f"{cause.effect}.position_{axis}", joint, float(std))


def _of_controllers(found: Diagnosis) -> Iterator[Refinable]:
    names = {DELAY: ("delay", "delay"), "torque_saturation": ("limit", "torque")}
    for cause in found.causes:
        if cause.effect in names:
            what, parameter = names[cause.effect]
            size = cause.parameters[parameter]
            yield Refinable(what, cause.joint, float(size.std), -float(size.value))


def by_words(number: Refinable, by: float) -> str:
    """Return by how much a number was refined, in words."""
    what = {"scale": "kp and kd", "limit": "torque limit"}.get(
        number.what, number.what.replace("_", " ")
    )
    ratio = number.what in ("scale", "kd", "armature", "mass")
    size = f"{100.0 * by:+.2g} %" if ratio else f"{by:+.2g}"
    return f"{what} of {number.joint or 'all joints'} by {size}"


def refine(
    arm: MjcfArm, robot: Robot, numbers: Sequence[Refinable], fitted: Sequence[Judging]
) -> Array:
    """Return by how much to change numbers of a corrected arm, (k,); zeros where that brings
    nothing.

    arm: the model of `robot`, as it is played; numbers: what may change; fitted: recordings that
    were fitted.
    """
    none = np.zeros(len(numbers))
    spans = list(_spans(fitted))
    if not numbers or not spans or plays_by_step(arm):
        return none
    best = _Search(arm, robot, tuple(numbers), spans).best()
    return none if best is None else best


def robot_at(robot: Robot, numbers: Sequence[Refinable], x: Array) -> Robot:
    """Return an arm with numbers (k,) by x away from its own."""
    for number, by in zip(numbers, x, strict=True):
        for joint in robot.joints:
            if number.joint in (joint.name, None):
                robot = _changed(robot, joint.name, number.what, float(by))
    return robot


def _changed(robot: Robot, name: str, what: str, by: float) -> Robot:
    joint = robot.joints[robot.joint_names.index(name)]
    drive, link = joint.controller, joint.link
    if what in FRICTION or what.partition(".")[0] in MASSES:
        effects = tuple(_moved(effect, name, what, by) for effect in robot.effects)
        return robot.with_(effects=effects)
    if what == "armature":
        return robot.with_joint(name, armature=(joint.armature or 0.0) * (1.0 + by))
    if what == "mass":
        heavier = replace(
            link, mass=link.mass * (1.0 + by), inertia=np.asarray(link.inertia) * (1.0 + by)
        )
        return robot.with_joint(name, link=heavier)
    if what.startswith("com_"):
        com = np.asarray(link.com, dtype=float) + by * np.eye(3)["xyz".index(what[-1])]
        return robot.with_joint(name, link=replace(link, com=com))
    assert drive is not None
    if what == "delay":
        return robot.with_joint(name, controller=replace(drive, delay=max(0.0, drive.delay + by)))
    if what == "limit":
        limit = None if drive.torque is None else max(1e-6, drive.torque + by)
        return robot.with_joint(name, controller=replace(drive, torque=limit))
    kp = 1.0 + by if what == "scale" else 1.0
    return robot.with_joint(name, controller=drive.scaled(kp, 1.0 + by))


def _moved(effect: Mapping[str, Any], joint: str, what: str, by: float) -> Mapping[str, Any]:
    name, _, parameter = what.partition(".")
    if effect["effect"] != name or effect["joint"] not in (joint, None):
        return effect
    values = dict(effect["parameters"])
    if parameter.startswith("position"):
        values["position"] = [
            v + by * (axis == parameter[-1])
            for axis, v in zip("xyz", values["position"], strict=True)
        ]
    else:
        key = parameter or FRICTION[name]
        values[key] = max(0.0, values[key] + by)
    return {**effect, "parameters": values}


def _spans(fitted: Sequence[Judging]) -> Sequence[Judging]:
    """Return the longest stretches, LONGEST s of them together."""
    found = [Judging(one.recording, span) for one in fitted for span in one.stretches()]
    share = LONGEST / max(1, len(found))
    cut = []
    for one in found:
        assert one.span is not None
        begin, end = one.span
        cut.append(Judging(one.recording, (begin, min(end, begin + share))))
    return cut


class _Search:
    """Gauss-Newton over simulations."""

    def __init__(
        self, arm: MjcfArm, robot: Robot, numbers: Sequence[Refinable], spans: Sequence[Judging]
    ) -> None:
        self.arm, self.robot, self.numbers, self.spans = arm, robot, numbers, spans
        self.stds = np.array([one.std for one in numbers])
        self.least = np.array([one.least for one in numbers])
        self.before = stated_arm(robot)
        self.carriers = [int(arm.model.jnt_bodyid[joint]) for joint in arm.chain.joints]

    def best(self) -> Array | None:
        """Return the best deviations (k,); None where none is better than where the search
        began."""
        x = np.zeros(len(self.numbers))
        here = self.errors(x)
        if here is None:
            return None
        first = self.loss(here)
        best = first
        for _ in range(ROUNDS):
            weights = 1.0 / np.sqrt(np.mean(here**2, axis=0) + self.unseen)
            columns = self.slopes(x, here)
            step = self.step(x, here * weights, columns * weights)
            there = self.errors(x + step)
            for _ in range(3):
                if there is not None and self.loss(there) < best:
                    break
                step = 0.3 * step
                there = self.errors(x + step)
            if there is None or self.loss(there) >= best:
                break
            gained = best - self.loss(there)
            x, here, best = x + step, there, self.loss(there)
            if gained < LITTLE:
                break
        return x if best < first else None

    def step(self, x: Array, errors: Array, columns: Array) -> Array:
        """Return the change of x (k,) by the linear problem in deviations, within what simulators
        take."""
        scaled = columns.reshape(len(x), -1).T * self.stds
        away = x / self.stds
        trust = np.sqrt((TAILS + 1.0) / (TAILS + away**2))
        rows = np.vstack([scaled, np.diag(trust)])
        wanted = np.concatenate([-errors.ravel(), -trust * away])
        low = np.minimum((self.least - x) / self.stds, -1e-9)
        normal = rows.T @ rows
        factor = np.linalg.cholesky(normal)
        return np.asarray(
            self.stds
            * lsq_linear(factor.T, np.linalg.solve(factor, rows.T @ wanted), (low, np.inf)).x
        )

    def slopes(self, x: Array, here: Array) -> Array:
        """Return the derivatives (k, N, n) of the errors."""
        found = np.zeros((len(x), *here.shape))
        for k, std in enumerate(self.stds):
            moved = x.copy()
            moved[k] += DIFFERENCE * std
            there = self.errors(moved)
            if there is not None:
                found[k] = (there - here) / (DIFFERENCE * std)
        return found

    def loss(self, errors: Array) -> float:
        """Return the mean over joints of the logarithm of mean squares."""
        return float(np.mean(np.log(np.mean(errors**2, axis=0) + self.unseen)))

    def errors(self, x: Array) -> Array | None:
        """Return the errors (N, n) at deviations x; None where no simulator takes them."""
        try:
            arm = self.model_at(robot_at(self.robot, self.numbers, x))
        except (RobotError, np.linalg.LinAlgError):
            return None
        plays = [play(arm, one.recording, span=one.span) for one in self.spans]
        found = [one for one in plays if one is not None]
        if not found:
            return None
        self.unseen = np.min([one.resolution for one in found], axis=0) ** 2 / 12.0 + 1e-12
        errors = np.concatenate([one.errors for one in found])
        return errors if np.isfinite(errors).all() else None

    def model_at(self, robot: Robot) -> MjcfArm:
        """Return the model with the numbers of another arm of the same shape."""
        mj, after = engine(), stated_arm(robot)
        model = copy.copy(self.arm.model)
        for i, (joint, own, new) in enumerate(
            zip(self.arm.chain.joints, self.robot.joints, robot.joints, strict=True)
        ):
            dof = int(model.jnt_dofadr[joint])
            old, numbers = self.before.joints[i], after.joints[i]
            model.dof_armature[dof] += numbers.armature - old.armature
            model.dof_damping[dof] = max(
                0.0, model.dof_damping[dof] + numbers.damping - old.damping
            )
            dry = model.dof_frictionloss[dof] + numbers.friction_loss - old.friction_loss
            model.dof_frictionloss[dof] = max(0.0, dry)
            if differs(self.before.links[i], after.links[i]):
                self._inertia(model, i, after.links[i])
            (drive,) = drives_of(model, joint)
            assert own.controller is not None and new.controller is not None
            kp = new.controller.kp / own.controller.kp
            model.actuator_gainprm[drive, 0] *= kp
            model.actuator_biasprm[drive, 1] *= kp
            if own.controller.kd:
                model.actuator_biasprm[drive, 2] *= new.controller.kd / own.controller.kd
            if own.controller.torque and new.controller.torque:
                model.actuator_forcerange[drive] *= new.controller.torque / own.controller.torque
            room = float(model.actuator_history[drive, 0] - 1) * float(model.opt.timestep)
            if room > 0.0:
                model.actuator_delay[drive] = min(room, new.controller.delay)
        mj.mj_setConst(model, mj.MjData(model))
        return replace(self.arm, model=model)

    def _inertia(self, model: Any, i: int, link: Any) -> None:
        """Change the body that carries a joint so that its link is another one."""
        body = self.carriers[i]
        new = body_after(
            own_inertia(self.arm.model, body), self.before.links[i], link, self.robot.link_names[i]
        )
        moments, axes = np.linalg.eigh(np.asarray(new.inertia))
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        quaternion = np.empty(4)
        engine().mju_mat2Quat(quaternion, axes.ravel())
        model.body_mass[body], model.body_ipos[body] = new.mass, new.com
        model.body_inertia[body], model.body_iquat[body] = moments, quaternion
