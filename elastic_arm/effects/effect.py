"""The definition of an effect.

An effect is a law with its parameters and texts. The law is its contribution to the three residuals
of a joint (:class:`~elastic_arm.effects.motion.Contribution`) as an expression; the simulator adds
the same expression to the equations of motion. Kinds of effects differ only in how they enter a
simulated arm:

- :class:`Effect`: through its law, in the equations;
- :class:`SensorEffect`: through the sensors;
- :class:`StructuralEffect`: through the parts of the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from string import Formatter
from typing import Any

import casadi as ca

from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Choice, Parameter, Role, combinations
from elastic_arm.effects.regressor import RegressorOf
from elastic_arm.errors import EffectError
from elastic_arm.robot import Joint, JointController, Robot
from elastic_arm.sensors import Sensors

Value = float | tuple[float, ...] | tuple[str, ...] | str
Law = Callable[[SymbolicMotion, int, Mapping[str, Any]], Contribution]

MODELS = ("mod1", "mod2", "mod3")
SIDES = ("link", "drive", "motor")
REGIMES = (
    "always", "velocity_reversal", "low_speed", "high_speed", "acceleration", "load", "position",
    "rotor_angle", "wave_generator_angle", "frequency", "start", "drift",
)  # fmt: skip


class Scope(Enum):
    """On which joints an effect can sit."""

    EACH = "each joint"
    LAST = "the last joint"
    BUT_LAST = "each joint but the last"
    ARM = "the whole arm"
    EACH_OR_ARM = "each joint, or one value for all"


@dataclass(frozen=True)
class Confusion:
    """Another effect that a recording may not separate from this one.

    When, and which motion would.
    """

    effect: str
    when: str
    separated_by: str


@dataclass(frozen=True)
class Plant:
    """An arm about to be simulated, as effects find and change it."""

    # robot, sensors: the true arm and its sensors
    robot: Robot
    sensors: Sensors
    bearings: bool = False  # whether its bearings tilt
    laws: tuple[EffectInstance, ...] = ()  # effects whose laws enter the equations


@dataclass(frozen=True)
class Effect:
    """An effect that acts through its law; an EffectError if its entries contradict each other."""

    id: str  # as in the contract
    formula: str  # the law as text
    description: str  # what it is
    signature: str  # what an engineer sees of it in a recording
    law: Law  # (motion, joint index, parameters and internal states by name) -> contribution
    # parameters, choices: its numbers, and what else has to be chosen
    parameters: tuple[Parameter, ...] = ()
    choices: tuple[Choice, ...] = ()
    # scope, sides, regime: where it shows
    scope: Scope = Scope.EACH
    sides: tuple[str, ...] = ()
    regime: str = "always"
    # what a joint with it does, with its numbers by name: "loses {torque} of dry friction"; its
    # name where empty
    plain: str = ""
    # names of internal states, which stay within -1 and 1; they start at zero in a simulation
    states: tuple[str, ...] = ()
    # for a transmission error: (motion, joint index, parameters) -> e(theta) and its rate, which
    # all laws of the joint then find in the deflection
    twist: Callable[[SymbolicMotion, int, Mapping[str, Any]], tuple[ca.SX, ca.SX]] | None = None
    sides_of: Callable[[Mapping[str, Any]], tuple[str, ...]] | None = None
    confusions: tuple[Confusion, ...] = ()  # what it may be mistaken for
    # names of the parameters that are its size: one, or several that are the components of one; the
    # first parameter where none is named
    magnitude: tuple[str, ...] = ()
    # whether it shows by the motion of its own joint alone. A drive is wound where its joint stands
    # still, too
    needs_motion: bool = False
    # whether it is an error of the model's own parameters: where these are identified first,
    # nothing of it is left
    model_parameter: bool = False
    # name of the number of an arm's description that it is an error of, where it is one alone:
    # "stiffness"
    number: str = ""
    lacked_by: tuple[str, ...] = MODELS  # model variants that lack it
    # (equations of an arm) -> its regressor, where the law is not enough. Parameters that act
    # linearly keep columns that are derivatives of the law; the regressor then is the effect at
    # given values of all parameters
    regressor: RegressorOf | None = None
    # (sample rate in Hz) -> standard deviation of its first parameter over ordinary arms of a
    # refit; None where an ordinary arm has none of it
    prior: Callable[[float], float] | None = None
    # whether it may be another one in each recording: a zero that is set anew at each start
    set_at_start: bool = False
    friction: bool = False  # whether it is friction: what laws find as the friction of its side
    # scales_friction, in_time: whether the law takes the friction of the side (`motion.friction`),
    # and how much of the recording has passed (`motion.progress`, or `motion.elapsed` in s)
    scales_friction: bool = False
    in_time: bool = False
    # whether a diagnosis looks for it; False for what acts only where a description or a user
    # states it
    searched: bool = True

    def __post_init__(self) -> None:
        if not self.magnitude and self.parameters:
            object.__setattr__(self, "magnitude", (self.parameters[0].name,))
        for problem, remedy in self._contradictions():
            raise EffectError(f"effect {self.id}: {problem}", remedy)

    def _contradictions(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the entries, and what to do about it."""
        if not self.id.isidentifier():
            yield (
                f"{self.id!r} is not a valid id",
                "Use lower-case letters, digits and _, such as rubber_buffer.",
            )
        names = [*self.names, *self.states]
        if twice := next((name for name in names if names.count(name) > 1), None):
            yield (
                f"{twice} has two meanings",
                "Give parameters, choices and states different names.",
            )
        if missing := [
            text for text in ("formula", "description", "signature") if not getattr(self, text)
        ]:
            yield f"its {missing[0]} is empty", "Write a sentence for the reports."
        for what, given, known in (
            ("sides", self.sides, SIDES), ("regime", (self.regime,), REGIMES),
            ("lacked_by", self.lacked_by, MODELS),
            ("magnitude", self.magnitude, tuple(p.name for p in self.parameters)),
        ):  # fmt: skip
            if unknown := [value for value in given if value not in known]:
                yield (
                    f"{what} contains {unknown[0]!r}",
                    f"Choose among {', '.join(known) or 'nothing: it has no parameter'}.",
                )
        if not self.sides or not self.lacked_by:
            yield (
                "it is visible in no equation or no model",
                f"Give sides, among {', '.join(SIDES)}, and models that lack it.",
            )
        if unknown := [
            name for _, name, *_ in Formatter().parse(self.plain) if name and name not in self.names
        ]:
            yield (
                f"its plain words contain the unknown name {unknown[0]!r}",
                f"Choose among {', '.join(self.names) or 'nothing'}.",
            )
        linear = [p for p in self.parameters if p.role is Role.LINEAR]
        phases = [p for p in self.parameters if p.role is Role.PHASE]
        if phases and (len(linear) != 1 or linear[0].size != 1 or len(phases) > 1):
            yield (
                f"its phase {phases[0].name} needs exactly one amplitude",
                "Give one parameter of role LINEAR before the one of role PHASE.",
            )
        if self.regressor is not None and phases:
            yield (
                "an effect with its own regressor cannot have a phase",
                "Give it role=Role.SEARCHED.",
            )

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name."""
        return next(p for p in self.parameters if p.name == name)

    @property
    def entries(self) -> tuple[Parameter | Choice, ...]:
        """All parameters and choices."""
        return (*self.parameters, *self.choices)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters and choices."""
        return tuple(entry.name for entry in self.entries)

    def added_to(self, plant: Plant, instance: EffectInstance) -> Plant:
        """Return the arm with the effect in it."""
        return replace(plant, laws=(*plant.laws, instance))

    def places(self, robot: Robot) -> tuple[str | None, ...]:
        """Return the names of the joints on which it can sit, None for the whole arm."""
        joints = robot.joint_names
        return {
            Scope.EACH: joints,
            Scope.LAST: joints[-1:],
            Scope.BUT_LAST: joints[:-1],
            Scope.ARM: (None,),
            Scope.EACH_OR_ARM: (None, *joints),
        }[self.scope]

    def candidates(self, robot: Robot) -> Iterator[EffectInstance]:
        """Return the effect at every place and choice, without effect where it can be.

        Parameters without a neutral value stand at their default, or in the middle of their
        plausible range.
        """
        start = {p.name: p.start() for p in self.parameters}
        for joint in self.places(robot):
            for chosen in combinations(self.choices):
                yield EffectInstance(self, joint, {**start, **chosen})


@dataclass(frozen=True)
class SensorEffect(Effect):
    """An effect of what the sensors record; its law is written in recorded channels."""

    # (sensors, joint index, n, parameters) -> sensors
    change: Callable[[Sensors, int, int, Mapping[str, Any]], Sensors] = field(kw_only=True)

    def added_to(self, plant: Plant, instance: EffectInstance) -> Plant:
        """Return the arm with its sensors changed."""
        sensors = plant.sensors
        n = plant.robot.n
        for i in instance.joint_indices(plant.robot):
            sensors = self.change(sensors, i, n, instance.parameters)
        return replace(plant, sensors=sensors)


@dataclass(frozen=True)
class StructuralEffect(Effect):
    """An effect of what the arm is made of."""

    # (plant, parameters) -> plant
    change: Callable[[Plant, Mapping[str, Any]], Plant] = field(kw_only=True)

    def added_to(self, plant: Plant, instance: EffectInstance) -> Plant:
        """Return the arm with its parts changed."""
        return self.change(plant, instance.parameters)


@dataclass(frozen=True)
class ControllerEffect(Effect):
    """An effect of a drive's controller.

    Its law is written in commands, and it is one of controllers that are stated.
    """

    change: Callable[[JointController, Mapping[str, Any]], JointController] = field(kw_only=True)
    # name of the number that it is an error of where the joint's duty was recorded; empty where it
    # is `number`
    number_of_duty: str = ""

    def number_at(self, joint: Joint) -> str:
        """Return the name of the number of a joint that it is an error of; empty where it is
        none."""
        return self.number_of_duty if joint.follows_duty and self.number_of_duty else self.number

    def added_to(self, plant: Plant, instance: EffectInstance) -> Plant:
        """Return the arm with its controllers changed."""
        robot = plant.robot
        for i in instance.joint_indices(robot):
            if (controller := robot.joints[i].controller) is None:
                raise no_controller(robot.joints[i].name)
            robot = robot.with_joint(
                robot.joints[i].name, controller=self.change(controller, instance.parameters)
            )
        return replace(plant, robot=robot)


def no_controller(joint: str) -> EffectError:
    """Return the error of an effect of a controller that is not stated."""
    remedy = f"State it in the arm file, such as `controller: {{{joint}: {{kp: 30, kd: 0.5}}}}`."
    return EffectError(f"the description states no controller for {joint}", remedy)


@dataclass(frozen=True)
class EffectInstance:
    """An effect on an arm; an EffectError if a parameter is unknown, missing, or makes no sense."""

    effect: Effect  # what acts
    joint: str | None  # name of the joint; None for the whole arm
    # every parameter and choice by name; those with a default may be left out
    parameters: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        effect = self.effect
        given = dict(self.parameters)
        unknown = [name for name in given if name not in effect.names]
        if unknown:
            valid = ", ".join(effect.names) or "none: it has no free parameter"
            raise EffectError(
                f"{effect.id} has no parameter {unknown[0]!r}", f"Its parameters are {valid}."
            )
        values: dict[str, Value] = {}
        for entry in effect.entries:
            value = given.get(entry.name, entry.default)
            if value is None:
                raise EffectError(
                    f"{effect.id} lacks its parameter {entry.name}",
                    f"Write it as {effect.id}:JOINT:{entry.name}=VALUE.",
                )
            values[entry.name] = entry.checked(value, effect.id)
        object.__setattr__(self, "parameters", values)

    @property
    def sides(self) -> tuple[str, ...]:
        """The equations in which it shows."""
        return self.effect.sides_of(self.parameters) if self.effect.sides_of else self.effect.sides

    @property
    def numbers(self) -> dict[str, Any]:
        """The parameters that are numbers."""
        return {p.name: self.parameters[p.name] for p in self.effect.parameters}

    def joint_indices(self, robot: Robot) -> tuple[int, ...]:
        """Return the joints it sits on: one, or all for an effect of the whole arm."""
        scope = self.effect.scope
        names = robot.joint_names
        if self.joint is None:
            if scope in (Scope.ARM, Scope.EACH_OR_ARM):
                return tuple(range(robot.n))
            if scope is Scope.LAST:
                return (robot.n - 1,)
            raise EffectError(f"{self.effect.id} needs a joint", f"Give one of {', '.join(names)}.")
        if self.joint not in names:
            raise EffectError(
                f"{self.effect.id}: unknown joint {self.joint!r}",
                f"Use one of {', '.join(names)}.",
            )
        if self.joint not in (places := self.effect.places(robot)):
            sits = ", ".join(place for place in places if place) or "no joint of this arm"
            raise EffectError(
                f"{self.effect.id} cannot act on {self.joint}",
                (
                    "Omit the joint: the effect acts on the whole arm."
                    if scope is Scope.ARM
                    else f"It acts on {sits}."
                ),
            )
        return (names.index(self.joint),)

    def with_parameters(self, **parameters: Value) -> EffectInstance:
        """Return the effect with these parameters changed."""
        return replace(self, parameters={**self.parameters, **parameters})

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, as in an arm file's `effects` list."""
        plain = {k: list(v) if isinstance(v, tuple) else v for k, v in self.parameters.items()}
        return {"effect": self.effect.id, "joint": self.joint, "parameters": plain}

    def __str__(self) -> str:
        values = ",".join(f"{k}={_text(v)}" for k, v in self.parameters.items())
        return ":".join(part for part in (self.effect.id, self.joint, values) if part)


def _text(value: Value) -> str:
    if isinstance(value, tuple):
        return ("+" if isinstance(value[0], str) else "/").join(_text(v) for v in value)
    return value if isinstance(value, str) else f"{value:.9g}"
