"""Refinement of the numbers of a corrected servo arm by the output error of its simulation.

    min over x of  sum over joints of N_j / 2 (log s_j² + mean |q(t_k; x) - q_k|² / s_j²)
                   + sum of 5/2 log(1 + ((x - d) / p)² / 4)

x are numbers of the arm, q the angles of MuJoCo's servos under the commands of the N samples of the
fitted recordings, and s_j² the mean square error of a joint, at least the variance by the steps of
its encoder. d is the described value and p the ordinary deviation (with the tails of Student's t,
because the diagnosis may have missed causes), or the size of a cause and its standard deviation.

The search starts at the diagnosis, or at the description with its causes if that is nearer, with
steps of Levenberg and Marquardt; :mod:`.sensitivity` provides the derivatives. A step is linear in
gains, armatures, masses and first moments of mass, as the dynamics are. If only a few
numbers are fitted and the model lacks something, a joint that sticks at another angle makes one
error and not one per sample. N_j, otherwise N, is then N over the integrated autocorrelation time
of the errors (Sokal, 1997) after a first search.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from elastic_arm.arrays import Array, rms
from elastic_arm.codegen.parallel import share_out
from elastic_arm.errors import RobotError
from elastic_arm.evidence.watch import Stage, Watch
from elastic_arm.mujoco.changed_numbers import body_after, differs
from elastic_arm.mujoco.closed_loop import (
    Play,
    play,
    robot_at_gains,
    with_controllers,
)
from elastic_arm.mujoco.judgement import Judging
from elastic_arm.mujoco.mjcf_export import own_inertia
from elastic_arm.mujoco.refinable import Moved, Refinable, robot_at
from elastic_arm.mujoco.sensitivity import derivatives
from elastic_arm.mujoco.stated_arm import stated_arm
from elastic_arm.robot import Robot
from elastic_arm.robot.mjcf import MjcfArm, engine
from elastic_arm.robot.mjcf.drives import drives_of, set_controller

LONGEST = 10.0  # s that are simulated of a recording
TOGETHER = 30.0  # s that are simulated of all of them
FORGOTTEN = 0.5  # s, in which a servo forgets the rate with which it began, known badly
ROUNDS = 30
EACH = 0.9  # share of the rounds that is typically still to come after each
BY_DIFFERENCES = (
    8  # rounds with derivatives by simulations, which take as many as there are numbers
)
FINITE = 0.1  # of a number's deviation, over which those are taken
TAILS = 4.0  # degrees of freedom of Student's t
LITTLE = 0.5  # nats of independent samples that a round gains which is the last
DIFFERENCE = 0.01  # of a number's deviation, over which derivatives are taken
DAMPING = 1e-3  # of the first step, in deviations; less after one that gains, more after others
FIRMEST = 1e6  # damping, with which nothing more can be gained
TINY = 1e-9  # numerical; of directions of which neither errors nor priors tell


def refine(
    arm: MjcfArm,
    robot: Robot,
    numbers: Sequence[Refinable],
    fitted: Sequence[Judging],
    *,
    alone: bool = False,
    watch: Watch | None = None,
) -> tuple[Moved, ...]:
    """Return by how much to change numbers of a corrected arm; none where nothing can be played.

    arm: the model of `robot`, as it is played; numbers: what may change; fitted: recordings that
    were fitted; alone: whether these few numbers are fitted where more may be lacking: with
    derivatives by simulations, as many as there are numbers, and once more with the samples that
    are independent; watch: is told of the rounds, and may end the search, which then returns the
    best numbers so far: none before it begins.
    """
    watch = watch or Watch()
    spans = list(_spans(fitted))
    none = not numbers or not spans or engine().get_mjcb_passive() is not None
    if none or watch.is_over():
        return ()
    return _Search(arm, robot, tuple(numbers), spans, watch).best(alone=alone)


def _spans(fitted: Sequence[Judging]) -> Sequence[Judging]:
    """Return the stretches, each as far as LONGEST and their share of TOGETHER reach."""
    found = [Judging(one.recording, span) for one in fitted for span in one.stretches()]
    share = min(LONGEST, TOGETHER / max(1, len(found)))
    cut = []
    for one in found:
        assert one.span is not None
        begin, end = one.span
        cut.append(Judging(one.recording, (begin, min(end, begin + share))))
    return cut


@dataclass(frozen=True)
class _Point:
    """Where the search is."""

    x: Array  # (k,)
    arm: MjcfArm
    plays: tuple[Play, ...]
    gains: tuple[Mapping[str, float], ...]  # in the servos' registers, of each
    value: float  # what is minimised, nats
    weights: Array  # (n,) of errors, 1/rad

    @property
    def errors(self) -> Array:
        """Errors of all recordings, (N, n) rad."""
        return np.concatenate([one.errors for one in self.plays])

    @property
    def words(self) -> str:
        """The root mean square of the errors of all joints, in words."""
        return f"{1e3 * float(rms(self.errors, None)):.3g} mrad"

    def apart(self) -> Array:
        """Return the share of samples (n,) that are independent of one another."""
        times = np.array([_correlated(one.errors) for one in self.plays])
        counts = np.array([len(one.errors) for one in self.plays])
        return np.asarray(counts @ (1.0 / times) / counts.sum())


def _correlated(errors: Array) -> Array:
    """Return the integrated autocorrelation times (n,) of errors (N, n), in samples: 1 where they
    are white."""
    count = len(errors)
    power = np.abs(np.fft.rfft(errors, 2 * count, axis=0)) ** 2
    covariance = np.fft.irfft(power, axis=0)[:count]
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(covariance / covariance[0])
    positive = np.logical_and.accumulate(correlation[1:] > 0.0, axis=0)
    return np.asarray(1.0 + 2.0 * np.sum(correlation[1:] * positive, axis=0))


def after_step(numbers: Sequence[Refinable], x: Array, step: Array) -> Array:
    """Return the numbers x (k,) after a step (k,) that is linear in what the dynamics are linear
    in: gains, armatures, masses and first moments of mass.

    Many steps change these, but hardly the motion. If logarithms of masses and centres of mass went
    straight instead, their terms of second order would move the arm further than the step.
    """
    places = {(one.what, one.joint): k for k, one in enumerate(numbers)}
    moves = zip(numbers, step.tolist(), strict=True)
    found = x + np.array([one.change(by) for one, by in moves])
    for k, number in enumerate(numbers):
        if number.factor is None or (number.factor, number.joint) not in places:
            continue
        place = places[number.factor, number.joint]
        before = numbers[place].size(x[place])
        after = numbers[place].size(found[place])
        found[k] = x[k] + number.change(step[k] * before / after)
    return found


Slopes = Callable[[_Point], Array]


class _Search:
    """Levenberg's and Marquardt's steps over simulations."""

    def __init__(
        self,
        arm: MjcfArm,
        robot: Robot,
        numbers: Sequence[Refinable],
        spans: Sequence[Judging],
        watch: Watch,
    ) -> None:
        self.arm = arm
        self.robot = robot
        self.numbers = numbers
        self.spans = spans
        self.watch = watch
        self.stds = np.array([one.std for one in numbers])
        self.least = np.array([one.least for one in numbers])
        self.stated = np.array([one.stated for one in numbers])
        self.prior = np.array([one.prior for one in numbers])
        self.before = stated_arm(robot)
        self.carriers = [int(arm.model.jnt_bodyid[joint]) for joint in arm.chain.joints]
        self.apart = np.ones(robot.n)  # share of the samples that tell apart, by joint

    def best(self, *, alone: bool) -> tuple[Moved, ...]:
        """Return the numbers where they are best; none where no simulator takes the arm."""
        of_causes = np.array([one.is_cause for one in self.numbers])
        described = np.where(of_causes, 0.0, np.maximum(self.stated, self.least))
        starts = np.zeros(len(self.numbers)), described
        found = [point for x in starts if (point := self.at(x)) is not None]
        if not found:
            return ()
        here = min(found, key=lambda one: one.value)
        here = self.descended(here, self.slopes, ROUNDS)
        if alone and not self.watch.is_over():
            here = self.descended(here, self.differences, BY_DIFFERENCES)
            self.apart = here.apart()
            again = [point for x in (here.x, *starts) if (point := self.at(x)) is not None]
            # With all samples, numbers go far for what the model lacks: too far to come back from
            # where the tails of the priors are flat.
            ended = [self.descended(point, self.slopes, ROUNDS) for point in again]
            here = min(ended, key=lambda one: one.value)
            here = self.descended(here, self.differences, BY_DIFFERENCES)
        normal, _ = self.linear(here, self.slopes)
        stds = np.sqrt(np.diag(np.linalg.inv(normal))) * self.stds
        moved = zip(self.numbers, here.x, stds, strict=True)
        return tuple(Moved(number, float(by), float(std)) for number, by, std in moved)

    def descended(self, here: _Point, slopes: Slopes, rounds: int) -> _Point:
        """Return the point to which steps by some derivatives lead."""
        damping = DAMPING
        for k in range(rounds):
            self.watch.say(
                f"closed loop: {len(self.numbers)} numbers refined, round {k + 1} of at most"
                f" {rounds}, error {here.words}",
                Stage.CLOSED_LOOP,
                1.0 - EACH**k,
            )
            normal, gradient = self.linear(here, slopes)
            if self.watch.is_over():
                break
            gained = 0.0
            while damping < FIRMEST:
                step = self.step(here.x, normal, gradient, damping)
                there = self.at(after_step(self.numbers, here.x, step))
                gained = here.value - there.value if there is not None else 0.0
                if there is not None and gained > 0.0:
                    here = there
                    damping *= 0.1
                    break
                damping = max(DAMPING, 10.0 * damping)
            if gained * here.apart().mean() < LITTLE * self.apart.mean():
                break
        return here

    def step(self, x: Array, normal: Array, gradient: Array, damping: float) -> Array:
        """Return a change of x (k,) within what simulators take."""
        firm = normal + damping * np.eye(len(x))
        room = [one.room(value) for one, value in zip(self.numbers, x, strict=True)]
        low = np.minimum(-np.array(room) / self.stds, -1e-9)
        factor = np.linalg.cholesky(firm)
        wanted = -np.linalg.solve(factor, gradient)
        return np.asarray(self.stds * lsq_linear(factor.T, wanted, (low, np.inf)).x)

    def linear(self, here: _Point, slopes: Slopes) -> tuple[Array, Array]:
        """Return the matrix (k, k) and the gradient (k,) of the linear problem, in deviations."""
        weights = here.weights * np.sqrt(self.apart)
        columns = slopes(here) * weights
        scaled = columns.reshape(len(here.x), -1) * self.stds[:, None]
        away = (here.x - self.stated) / self.prior
        weight = (TAILS + 1.0) / (TAILS + away**2) * self.stds / self.prior
        normal = scaled @ scaled.T + np.diag(weight * self.stds / self.prior)
        normal += TINY * np.eye(len(normal))
        return normal, scaled @ (here.errors * weights).ravel() + weight * away

    def slopes(self, here: _Point) -> Array:
        """Return the derivatives (k, N, n) of the errors."""
        robot = robot_at(self.robot, self.numbers, here.x)
        others = []
        for number, by in zip(self.numbers, DIFFERENCE * self.stds, strict=True):
            others.append((robot_at(robot, [number], np.array([by])), float(by)))

        def of(play: tuple[Play, Mapping[str, float]]) -> Array:
            one, gains = play
            own = robot_at_gains(robot, gains)
            changed = [(robot_at_gains(other, gains), by) for other, by in others]
            return derivatives(own, changed, one.motion, one.t)

        plays = zip(here.plays, here.gains, strict=True)
        return np.concatenate(share_out(of, plays), axis=1)

    def differences(self, here: _Point) -> Array:
        """Return the derivatives (k, N, n) of the errors by simulations with one number changed
        each: a joint that sticks under friction by its load has others than its linear equation."""
        found = []
        for move in np.diag(FINITE * self.stds):
            there = None if self.watch.is_over() else self.at(here.x + move)
            change = np.zeros_like(here.errors) if there is None else there.errors - here.errors
            found.append(change / move.sum())
        return np.array(found)

    def at(self, x: Array) -> _Point | None:
        """Return a point of the search; None where no simulator takes it."""
        try:
            arm = self.model_at(robot_at(self.robot, self.numbers, x))
        except (RobotError, np.linalg.LinAlgError):
            return None
        played = share_out(lambda one: play(arm, one.recording, span=one.span), self.spans)
        plays = [(one.recording, motion) for one, motion in zip(self.spans, played, strict=True)]
        found = tuple(one.after(FORGOTTEN) for _, one in plays if one is not None)
        gains = tuple(each.firmware_gains for each, one in plays if one is not None)
        if not found or not all(np.isfinite(one.errors).all() for one in found):
            return None
        unseen = np.min([one.resolution for one in found], axis=0) ** 2 / 12.0 + 1e-12
        errors = np.concatenate([one.errors for one in found])
        squares = np.mean(errors**2, axis=0)
        variance = np.maximum(squares, unseen)
        away = (x - self.stated) / self.prior
        prior = 0.5 * (TAILS + 1.0) * float(np.sum(np.log1p(away**2 / TAILS)))
        misfit = self.apart * (np.log(variance) + squares / variance)
        value = 0.5 * len(errors) * float(np.sum(misfit)) + prior
        return _Point(x, arm, found, gains, value, 1.0 / np.sqrt(variance))

    def model_at(self, robot: Robot) -> MjcfArm:
        """Return the model with the numbers of another arm of the same shape."""
        mj = engine()
        after = stated_arm(robot)
        model = copy.copy(self.arm.model)
        held = self.arm.robot
        for i, (joint, own, new) in enumerate(
            zip(self.arm.chain.joints, self.robot.joints, robot.joints, strict=True)
        ):
            dof = int(model.jnt_dofadr[joint])
            old = self.before.joints[i]
            numbers = after.joints[i]
            model.dof_armature[dof] += numbers.armature - old.armature
            model.dof_damping[dof] = max(
                0.0, model.dof_damping[dof] + numbers.damping - old.damping
            )
            dry = model.dof_frictionloss[dof] + numbers.friction_loss - old.friction_loss
            model.dof_frictionloss[dof] = max(0.0, dry)
            model.qpos0[int(model.jnt_qposadr[joint])] += numbers.zero - old.zero
            if differs(self.before.links[i], after.links[i]):
                self._inertia(model, i, after.links[i])
            (drive,) = drives_of(model, joint)
            assert own.controller is not None and new.controller is not None
            set_controller(model, drive, own.controller, new.controller)
            # Set-points, and another firmware gain, follow what the arm states beside the model.
            stated = held.joints[i].controller
            if stated is not None:
                moved = {name: getattr(new.controller, name) for name in ("kp", "kd", "delay")}
                held = held.with_joint(new.name, controller=replace(stated, **moved))
        mj.mj_setConst(model, mj.MjData(model))
        return with_controllers(replace(self.arm, model=model, robot=held), robot)

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
        model.body_mass[body] = new.mass
        model.body_ipos[body] = new.com
        model.body_inertia[body] = moments
        model.body_iquat[body] = quaternion
