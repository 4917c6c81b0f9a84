"""The torque of an arm as a function for a controller: one file of C, Python or CasADi.

    torque(q, dq, ddq) = inverse_dynamics(q, dq, ddq) + friction(q, dq, ddq)
    gravity(q) = inverse_dynamics(q, 0, 0)

`inverse_dynamics` is the left side of (1) with the inertia of the motors and all laws of the arm's
effects except friction: loads, springs, zeros of joints, a tilted base. Motor and link move
together: for an elastic arm it is the sum of both rows of a joint at theta = q.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca

from elastic_arm.codegen.emit_source import Constant, c_source, identifier, python_source
from elastic_arm.codegen.program import from_casadi
from elastic_arm.effects import Catalogue, EffectInstance, SensorEffect, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import ControllerEffect, StructuralEffect
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.effects.motion import SymbolicMotion
from elastic_arm.mujoco.left_out import left_effects, left_numbers
from elastic_arm.mujoco.mjcf_export import Exported
from elastic_arm.mujoco.stated_arm import acts_by_law, reason_left
from elastic_arm.output_files import write_result
from elastic_arm.robot import Robot
from elastic_arm.simulation.simulator import SIGN_SPEED
from elastic_arm.version import __version__

SX = ca.SX
SIGN = Constant(
    "sign_speed",
    SIGN_SPEED,
    "Dry friction turns over within this speed, rad/s or m/s: sign(w) is tanh(w / speed).",
)


class Language(StrEnum):
    """What a torque function is written in."""

    c = "c"
    python = "python"
    casadi = "casadi"


def export_torque(
    robot: Robot,
    base: None,
    out: Path,
    *,
    language: Language,
    catalogue: Catalogue | None = None,
) -> Exported:
    """Write the torque function of an arm, and list what of the arm it does not hold.

    An OutputError if the file cannot be written.
    """
    held, left = _sorted(robot, catalogue)
    functions = torque_functions(robot, held)
    notes = list(_notes(robot))
    about = _about(robot, held, left, notes)
    if language is Language.casadi:
        write_result(out, _as_casadi(functions))
    else:
        programs = {name: from_casadi(one) for name, one in functions.items()}
        write_result(
            out,
            c_source(programs, SIGN, identifier(out.stem), about)
            if language is Language.c
            else python_source(programs, SIGN, about),
        )
    controllers = tuple(replace(joint, controller=None) for joint in robot.joints)
    numbers = left_numbers(
        robot.with_(joints=controllers),
        "motor and link turn alike in the function",
        elasticity=True,
    )
    listed = (*left_effects(robot, left, catalogue), *numbers)
    return Exported((out,), (), listed, notes=tuple(notes), units=robot.units)


def torque_functions(robot: Robot, instances: Sequence[EffectInstance]) -> dict[str, ca.Function]:
    """Return torque, inverse_dynamics, gravity and friction of an arm with effects that act by
    laws.

    Inputs are q, dq and ddq (n,), of gravity q alone, and sign_speed; the output is tau (n,).
    """
    n = robot.n
    equations = ArmEquations(robot)
    x = SX.sym("x", equations.dof)
    dx = SX.sym("dx", equations.dof)
    ddx = SX.sym("ddx", equations.dof)
    loads = SX.sym("tau_J", n), SX.sym("tau_m", n)
    speed = SX.sym(SIGN.name)
    unused = SX.zeros(n)
    signs = {"link": ca.tanh(dx[:n] / speed), "motor": ca.tanh(dx[-n:] / speed)}
    motion = SymbolicMotion(
        equations,
        x,
        dx,
        ddx,
        *loads,
        unused,
        unused,
        sign=lambda side, i: signs[side][i],
    )
    resisting = [one for one in instances if one.effect.friction or one.effect.scales_friction]
    others = [one for one in instances if one not in resisting]
    sets = [EffectSet(chosen, robot) for chosen in (others, resisting)]
    left_side = equations.left_side(x, dx, ddx)
    rigid, rubbing = (effects.contribution(motion)[0] for effects in sets)
    links = left_side[:n] + rigid.link
    inverse_dynamics = links + rigid.motor + (left_side[n:] if robot.elastic else 0.0)
    friction = rubbing.link + rubbing.motor
    link_torque = links + rubbing.link if robot.elastic else None
    loaded = _loads(link_torque, inverse_dynamics + friction, *loads)
    symbols = {name: SX.sym(name, n) for name in ("q", "dq", "ddq")}
    sides = 2 if robot.elastic else 1
    known = [x, dx, ddx, equations.Psi, *(effects.p for effects in sets)]
    values = [ca.repmat(symbol, sides, 1) for symbol in symbols.values()]
    values += [SX(equations.nominal), *(SX(effects.numbers()) for effects in sets)]

    def finished(expression: SX) -> SX:
        at_loads = ca.substitute([expression], list(loads), loaded)
        return ca.substitute(at_loads, known, values)[0]

    smooth = finished(inverse_dynamics)
    rough = finished(friction)
    still = [SX.zeros(n), SX.zeros(n)]
    held = ca.substitute([smooth], [symbols["dq"], symbols["ddq"]], still)[0]
    motions = {**symbols, SIGN.name: speed}
    return {
        "torque": _function("torque", motions, smooth + rough),
        "inverse_dynamics": _function("inverse_dynamics", motions, smooth),
        "gravity": _function("gravity", {"q": symbols["q"], SIGN.name: speed}, held),
        "friction": _function("friction", motions, rough),
    }


def _loads(link_torque: SX | None, torque: SX, tau_J: SX, tau_m: SX) -> list[SX]:
    """Return what the drives carry, and the motors' torque, as laws take them.

    What a drive carries is what its link needs. Without drives both are the motor's torque, to
    which friction adds that grows with it: one step of Newton solves that, as it is linear in the
    torque while its sign stays.
    """
    nothing = SX.zeros(tau_J.numel())
    if link_torque is not None:
        carried = ca.substitute([link_torque], [tau_J, tau_m], [nothing, nothing])[0]
        return [carried, ca.substitute([torque], [tau_J, tau_m], [carried, carried])[0]]
    load = SX.sym("load", tau_J.numel())
    of_load = ca.substitute([torque], [tau_J, tau_m], [load, load])[0]
    unloaded = ca.substitute(of_load, load, nothing)
    first = ca.substitute(of_load, load, unloaded)
    slopes = ca.substitute(ca.diag(ca.jacobian(of_load, load)), load, unloaded)
    solved = unloaded + (first - unloaded) / (1.0 - slopes)
    return [solved, solved]


def _function(name: str, inputs: Mapping[str, SX], result: SX) -> ca.Function:
    expressions = ca.cse([ca.densify(result)])
    return ca.Function(name, list(inputs.values()), expressions, list(inputs), ["tau"])


def _as_casadi(functions: dict[str, ca.Function]) -> bytes:
    """Return a file for `casadi.Function.load`: of (q, dq, ddq, sign_speed), with the four as
    outputs."""
    n = functions["gravity"].numel_in(0)
    given = {name: SX.sym(name, n) for name in ("q", "dq", "ddq")} | {SIGN.name: SX.sym(SIGN.name)}
    outputs = [one(*(given[name] for name in one.name_in())) for one in functions.values()]
    whole = ca.Function(
        "arm",
        list(given.values()),
        ca.cse(outputs),
        list(given),
        list(functions),
        {"default_in": [0.0, 0.0, 0.0, SIGN.value]},
    )
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.casadi"
        whole.save(str(path))
        return path.read_bytes()


def _sorted(
    robot: Robot, catalogue: Catalogue | None
) -> tuple[list[EffectInstance], list[tuple[EffectInstance, str]]]:
    """Return the effects of an arm that its torque function holds, and the others with reasons."""
    held = []
    left = []
    for instance in robot_effects(robot, catalogue):
        reason = _reason(instance)
        if reason:
            left.append((instance, reason))
        else:
            held.append(instance)
    return held, left


def _reason(instance: EffectInstance) -> str:
    """Return why a function of the motion alone cannot hold an effect; nothing where it can."""
    effect = instance.effect
    if isinstance(effect, SensorEffect | ControllerEffect):
        return reason_left(instance)
    if isinstance(effect, StructuralEffect) or not acts_by_law(effect):
        return "changes what the arm is made of"
    if instance.sides == ("drive",):
        return "acts within the drive, and motor and link turn alike in the function"
    if effect.states:
        return "depends on the motion before"
    return "changes over a recording" if effect.in_time else ""


def _notes(robot: Robot) -> Iterator[str]:
    unknown = [
        joint.name
        for joint in robot.joints
        if joint.transmission is None and joint.armature is None
    ]
    if unknown:
        yield (
            f"the description states no motor inertia of {', '.join(unknown)}: the torque lacks"
            " what accelerates the motors (`elastic-arm identify` finds it)"
        )


def _about(
    robot: Robot,
    held: Sequence[EffectInstance],
    left: Sequence[tuple[EffectInstance, str]],
    notes: Sequence[str],
) -> list[str]:
    """Return the lines of the comment at the beginning of the file."""
    units: Any = robot.units
    joints = [
        f"  {i} {joint.name} ({units.at(joint.name, 'rad')}, {units.at(joint.name, 'Nm')})"
        for i, joint in enumerate(robot.joints)
    ]
    return [
        f"Torque of {robot.name}, written by elastic_arm {__version__}.",
        "",
        "torque = inverse_dynamics + friction, of a motion (q, dq, ddq);",
        "gravity(q) is inverse_dynamics at rest. SI units; the joints in order:",
        *joints,
        *(["", "With these effects:"] if held else []),
        *(f"  {one}" for one in held),
        *(["", "Not in it:"] if left else []),
        *(f"  {one}: {reason}" for one, reason in left),
        *(f"  note: {one}" for one in notes),
    ]
