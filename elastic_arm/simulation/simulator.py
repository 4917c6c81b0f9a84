"""The simulator: sample by sample or a whole run at once, by the same code."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects import EffectInstance, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import Plant
from elastic_arm.effects.text import parse, read_effects
from elastic_arm.errors import ElasticArmError, SimulationError
from elastic_arm.robot import Robot
from elastic_arm.sensors import DelayLine, SensorBank, Sensors
from elastic_arm.simulation.assembly import System, assemble
from elastic_arm.simulation.controller import Controller, controller_of, fastest_eigenvalue
from elastic_arm.simulation.equilibrium import equilibrium
from elastic_arm.simulation.integrator import ClosedLoop, IntegratorState, Solution, make_integrator
from elastic_arm.simulation.settings import USUAL, SimulationSettings

# The sign of a velocity is tanh(w / speed): far below the speeds of an excitation (0.1 to 2 rad/s),
# yet wide enough that a motion through zero takes some steps.
SIGN_SPEED = 1e-4
# Friction steeper than this share of what the integrator can follow in a step is widened.
STEEPEST = 0.7


@dataclass(frozen=True)
class Truth:
    """What really happened at t (N,) s.

    (N, n) q, dq, tau_J, theta, dtheta, tau_m as sensors without fault read them.

    `x`, `dx` (N, dof) hold all coordinates, `z` (N, states) the internal states of effects,
    `command` (N, n) the torque held from each sample on. Torques at a stamp are means over the
    sample interval centred on it.
    """

    t: Array
    x: Array
    dx: Array
    z: Array
    tau_J: Array
    tau_m: Array
    command: Array
    n: int

    @property
    def q(self) -> Array:
        """Link angles."""
        return self.x[:, : self.n]

    @property
    def dq(self) -> Array:
        """Their rates."""
        return self.dx[:, : self.n]

    @property
    def theta(self) -> Array:
        """Motor angles."""
        return self.x[:, self._motor]

    @property
    def dtheta(self) -> Array:
        """Their rates."""
        return self.dx[:, self._motor]

    @property
    def _motor(self) -> slice:
        return slice(self.n, 2 * self.n) if self.x.shape[1] > self.n else slice(0, self.n)

    def channels(self) -> dict[str, Array]:
        """Return what sensors read, by name."""
        return {
            name: getattr(self, name) for name in ("q", "dq", "tau_J", "theta", "dtheta", "tau_m")
        }


class Simulator:
    """An arm with effects, sensors and a controller.

    What the arm's description lists under `effects` acts too, and its `controller` drives it. The
    motors start at q0 with dq0 (n,), zero when None; `duration`, s, is that of the run for effects
    that change over it, None where it has no end. Raises an EffectError or SimulationError if an
    effect cannot act on this arm, or the settings make no sense.
    """

    def __init__(
        self,
        robot: Robot,
        settings: SimulationSettings = USUAL,
        *,
        rng: np.random.Generator | None = None,
        q0: Array | None = None,
        dq0: Array | None = None,
        duration: float | None = None,
    ) -> None:
        _check_steps(settings.rate, settings.substeps)
        self.nominal = robot if settings.nominal is None else settings.nominal
        check_same_joints(robot, self.nominal)
        self.robot = robot
        self.rate = float(settings.rate)
        self._settings = settings
        self._duration = duration
        self._rng = np.random.default_rng() if rng is None else rng
        self._samples = 0
        self._build(settings.effects)
        start = np.zeros(robot.n) if q0 is None else np.asarray(q0, dtype=float)
        self.reset(start, None if dq0 is None else np.asarray(dq0, dtype=float))

    def _build(self, effects: Sequence[EffectInstance | str]) -> None:
        """Put arm, effects and sensors together."""
        settings = self._settings
        added = read_effects(effects, lambda text: [parse(text, self.robot, settings.catalogue)])
        self.effects = (*robot_effects(self.robot, settings.catalogue), *added)
        plant = Plant(
            self.robot,
            Sensors() if settings.sensors is None else settings.sensors,
            settings.bearings,
        )
        for instance in self.effects:
            instance.joint_indices(self.robot)
            plant = instance.effect.added_to(plant, instance)
        self.controller = (
            self._controlled(plant.robot) if settings.controller is None else settings.controller
        )
        equations = ArmEquations(plant.robot, settings.model, bearings=plant.bearings)
        self.system: System = assemble(equations, plant.laws, self._duration)
        self.integrator = make_integrator(self.system, settings.engine)
        self.sensors = SensorBank(plant.sensors, self.robot.n, self.rate, self._rng)

    def _controlled(self, plant: Robot) -> Controller:
        """Return the controller that the nominal arm states, with what effects have changed of the
        true arm's."""
        robot = self.nominal
        for name, true, own in zip(robot.joint_names, plant.joints, self.robot.joints, strict=True):
            if true.controller != own.controller:
                robot = robot.with_joint(name, controller=true.controller)
        return controller_of(robot, model=self._settings.model, rate=self.rate)

    def reset(self, q0: Array, dq0: Array | None = None) -> None:
        """Put motors at `q0` (n,), links where gravity leaves them.

        At rest or at velocities `dq0` (n,).
        """
        n = self.robot.n
        dq0 = np.zeros(n) if dq0 is None else dq0
        for what in (q0, dq0):
            if what.shape != (n,) or not np.isfinite(what).all():
                raise SimulationError(
                    f"the start {what} is not {n} finite numbers",
                    "Give one per joint, rad or rad/s.",
                )
        x, hold = equilibrium(self.system, q0, np.full(2 * n, SIGN_SPEED))
        z = np.zeros(self.system.states)
        controller = self.controller
        steps = self._steps(x, hold)
        self.sign_speed = sign_speed(
            self.system, self.system.equations.nominal, x, z, hold, 1.0 / (self.rate * steps)
        )
        constants = self.system.evaluate_constants(self.sign_speed)
        limits = [np.inf if j.limits.torque is None else j.limits.torque for j in self.robot.joints]
        limit = np.minimum(limits, controller.limit)
        gains = np.array([controller.kp, controller.kd, controller.ki, limit, controller.dead_band])
        self._loop = ClosedLoop(constants, gains, 1.0 / self.rate, steps // 2, controller.commands)
        self._late = (
            DelayLine(np.tile(controller.delay, 3), self.rate) if np.any(controller.delay) else None
        )
        self.place(x[:n], x[n : 2 * n], dq0, dq0, command=hold, z=z)
        self.state.y[2 * n : len(x)] = x[2 * n :]

    def _steps(self, x: Array, hold: Array) -> int:
        """Return the integration steps a sample: none longer than the time constant of the arm's
        fastest eigenvalue."""
        system = self.system
        rest = np.zeros_like(x)
        z = np.zeros(self.system.states)
        given = (
            system.equations.nominal,
            system.effect_set.numbers(),
            np.full(2 * system.n, SIGN_SPEED),
        )
        stiffness = np.array(system.stiffness_of_balance(x, rest, z, *given))
        mass = np.array(system.friction(x, rest, z, hold, *given)[1])
        damping = np.zeros_like(stiffness)
        for spring in system.equations.bodies.springs:
            ends = np.zeros(len(x))
            ends[spring.coordinate] = 1.0
            if spring.against is not None:
                ends[spring.against] = -1.0
            damping += system.equations.nominal[spring.damping] * np.outer(ends, ends)
        needed = max(
            self._settings.substeps, fastest_eigenvalue(mass, stiffness, damping) / self.rate
        )
        whole = max(2, self.controller.commands)
        return whole * int(np.ceil(needed / whole - 1e-9))

    @property
    def t(self) -> float:
        """Time of the present sample, s."""
        return self._samples / self.rate

    def follow(self, q: Array, dq: Array, ddq: Array) -> tuple[Truth, dict[str, Array]]:
        """Run over a reference of the motor side, (N, n) each, at the sample rate."""
        q = np.asarray(q, dtype=float)
        dq = np.asarray(dq, dtype=float)
        ddq = np.asarray(ddq, dtype=float)
        if self._late is not None:
            q, dq, ddq = np.split(self._late(np.concatenate([q, dq, ddq], axis=1)), 3, axis=1)
        return self._advance(self._loop, self.controller.commanded(q, dq, ddq, self.rate))

    def drive(self, tau_m: Array) -> tuple[Truth, dict[str, Array]]:
        """Run under given motor torques (N, n), Nm, each held for a sample; see :meth:`follow`."""
        tau_m = np.asarray(tau_m, dtype=float)
        gains = self._loop.gains * [[0.0], [0.0], [0.0], [1.0], [0.0]]
        reference = np.concatenate([np.zeros((len(tau_m), 2 * self.robot.n)), tau_m], axis=1)
        return self._advance(replace(self._loop, gains=gains, commands=1), reference)

    def step(
        self, reference: tuple[Array, Array, Array] | None = None, *, torque: Array | None = None
    ) -> tuple[Truth, dict[str, Array]]:
        """Advance by one sample under a reference (q, dq, ddq), each (n,), or a motor torque (n,).

        Returns truth and measured channels of the sample from which it advanced, (1, n) each: the
        very bits of :meth:`follow` or :meth:`drive` over many samples.
        """
        if (reference is None) == (torque is None):
            raise SimulationError("a step needs a reference or a torque", "Give one of the two.")
        if reference is not None:
            q, dq, ddq = (np.asarray(values, dtype=float)[None] for values in reference)
            return self.follow(q, dq, ddq)
        return self.drive(np.asarray(torque, dtype=float)[None])

    def place(
        self,
        q: Array,
        theta: Array,
        dq: Array,
        dtheta: Array,
        *,
        command: Array | None = None,
        z: Array | None = None,
    ) -> None:
        """Put the arm into a motion, (n,) each, from which a short prediction starts.

        Bearings start untilted. `command` is the motor torque held until now, `z` the internal
        states of effects; both are zero when None.
        """
        dof = self.system.dof
        parts = (q, theta) if self.robot.elastic else (q,)
        rates = (dq, dtheta) if self.robot.elastic else (dq,)
        x = np.pad(np.concatenate(parts), (0, dof - len(parts) * self.robot.n))
        dx = np.pad(np.concatenate(rates), (0, dof - len(rates) * self.robot.n))
        z = np.zeros(self.system.states) if z is None else np.asarray(z, dtype=float)
        held = np.zeros(self.robot.n) if command is None else np.array(command, dtype=float)
        tau_J = np.array(self.system.accelerations(x, dx, z, held, self._loop.constants)[2]).ravel()
        none = np.zeros(self.robot.n)
        self.state = IntegratorState(
            np.concatenate([x, dx, z]), 0.5 * tau_J / self.rate, 0.5 * held, held, none
        )

    def change_effects(self, effects: Sequence[EffectInstance]) -> None:
        """Go on from the present motion with other effects; internal states of effects start anew.

        Equations of a shape not met before are compiled, which takes a second or two.
        """
        before = vars(self).copy()
        try:
            self._change_effects(effects)
        except ElasticArmError:
            vars(self).update(before)
            raise

    def _change_effects(self, effects: Sequence[EffectInstance]) -> None:
        x = self.state.y[: self.system.dof]
        dx = self.state.y[self.system.dof : 2 * self.system.dof]
        before = self.state
        self._build(effects)
        dof = self.system.dof
        x = np.pad(x[:dof], (0, max(0, dof - len(x))))
        dx = np.pad(dx[:dof], (0, max(0, dof - len(dx))))
        self.reset(x[self.robot.n : 2 * self.robot.n] if self.robot.elastic else x)
        self.state = replace(before, y=np.concatenate([x, dx, np.zeros(self.system.states)]))

    def _advance(self, loop: ClosedLoop, reference: Array) -> tuple[Truth, dict[str, Array]]:
        solution = self.integrator.run(loop, reference, self.state)
        if len(solution.y) * loop.commands < len(reference):
            self._explain(solution)
        truth = self._truth(solution)
        self._samples += len(solution.y)
        return truth, self.sensors.read(truth.channels())

    def _truth(self, solution: Solution) -> Truth:
        dof = self.system.dof
        t = (self._samples + np.arange(len(solution.y))) / self.rate
        x = solution.y[:, :dof]
        dx = solution.y[:, dof : 2 * dof]
        z = solution.y[:, 2 * dof :]
        return Truth(t, x, dx, z, solution.tau_J, solution.tau_m, solution.command, self.robot.n)

    def _explain(self, solution: Solution) -> None:
        """Name time and joint of a motion that left the finite numbers."""
        last = solution.y[-1] if len(solution.y) else self.state.y
        dof = self.system.dof
        n = self.robot.n
        speeds = np.nan_to_num(np.abs(last[dof : 2 * dof]), nan=np.inf)
        joint = self.robot.joint_names[int(speeds.argmax()) % n]
        time = (self._samples + len(solution.y)) / self.rate
        raise SimulationError(
            f"simulation diverged (NaN or infinity) {time:.3f} s after the start, first at {joint}",
            "Use more substeps or weaker controller gains, or check the effects: "
            + (", ".join(str(a) for a in self.effects) or "there are none")
            + ".",
        )


def sign_speed(system: System, Psi: Array, x: Array, z: Array, hold: Array, step: float) -> Array:
    """Return the speed (2n,) below which friction of each side is regularised, rad/s.

    :data:`SIGN_SPEED`, or more where friction would outrun an integrator of this step (s):
    `friction step / inertia`.
    """
    rest = np.zeros_like(x)
    speed = np.full(2 * system.n, SIGN_SPEED)
    slope, mass = (
        np.array(m)
        for m in system.friction(x, rest, z, hold, Psi, system.effect_set.numbers(), speed)
    )
    mobility = np.abs(
        np.einsum("ik,ij,jk->k", slope, np.linalg.inv(mass), np.where(slope != 0, 1.0, 0.0))
    )
    return np.maximum(speed, mobility * step / STEEPEST)


def check_same_joints(robot: Robot, nominal: Robot) -> None:
    """Refuse, by a SimulationError, a nominal arm with another number of joints than `robot`."""
    if nominal.n != robot.n:
        raise SimulationError(
            f"the true arm {robot.name} has {robot.n} joints, the nominal arm {nominal.name} has"
            f" {nominal.n}",
            "Describe the same joints twice: in the true arm and in the nominal arm of"
            " the controller.",
        )


def _check_steps(rate: float, substeps: int) -> None:
    if not (np.isfinite(rate) and rate > 0):
        raise SimulationError(f"the sample rate is {rate!r} Hz", "Give a positive number.")
    if substeps < 2 or substeps % 2:
        raise SimulationError(
            f"{substeps} substeps per sample",
            "Give an even number: a torque sample is the mean of two half intervals.",
        )
