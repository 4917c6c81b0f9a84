"""Laws of the catalogue evaluated at given motions, for tests."""

import casadi as ca
import numpy as np

from elastic_arm.effects import EffectInstance, SymbolicMotion
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.robot import Robot

CHANNELS = ("x", "dx", "ddx", "tau_J", "tau_m", "dtau_J", "dtau_m", "dddx", "ddddx")

DURATION = 1.0  # s of a run

# One plausible instance of every effect, and the model that lacks it.
INSTANCES = {
    "viscous_friction": ("viscous_friction:joint_2:coefficient=20", "mod3"),
    "coulomb_friction": ("coulomb_friction:joint_2:torque=13.9", "mod3"),
    "stribeck_friction": ("stribeck_friction:joint_3:torque=6,speed=0.3", "mod3"),
    "load_dependent_friction": ("load_dependent_friction:joint_2:coefficient=0.03", "mod3"),
    "nonlinear_stiffness": ("nonlinear_stiffness:joint_2:cubic=3e8", "mod3"),
    "hysteresis": ("hysteresis:joint_2:torque=5,width=1e-4", "mod3"),
    "backlash": ("backlash:joint_3:half_gap=2e-4", "mod3"),
    "transmission_error": ("transmission_error:joint_2:amplitude=3e-5,phase=0.7", "mod3"),
    "torque_ripple": ("torque_ripple:joint_1:amplitude=4,phase=-0.4,order=1", "mod3"),
    "bearing_compliance": ("bearing_compliance:stiffness_scale=0.5", "mod3"),
    "payload": ("payload:mass=6,position=0.05/-0.02/0.1", "mod3"),
    "base_tilt": ("base_tilt:x=0.02,y=-0.01", "mod3"),
    "motor_torque_gain": ("motor_torque_gain:joint_2:gain=1.06", "mod3"),
    "joint_torque_gain": ("joint_torque_gain:joint_2:gain=0.93", "mod3"),
    "motor_torque_offset": ("motor_torque_offset:joint_1:offset=3", "mod3"),
    "joint_torque_offset": ("joint_torque_offset:joint_3:offset=-2", "mod3"),
    "encoder_offset": ("encoder_offset:joint_1:offset=2e-4", "mod3"),
    "encoder_eccentricity": ("encoder_eccentricity:joint_3:amplitude=3e-4,phase=1.1", "mod3"),
    "time_delay": ("time_delay:joint_2:delay=0.002,channels=joint_torque+motor_torque", "mod3"),
    "torque_drift": ("torque_drift:joint_2:rate=0.2", "mod3"),
    "torque_lowpass": (
        "torque_lowpass:joint_2:cutoff=5,channels=joint_torque+motor_torque",
        "mod3",
    ),
    "link_inertia_mismatch": (
        "link_inertia_mismatch:joint_2:mass=1.1,com=0.01/0/-0.02,inertia=1.05",
        "mod3",
    ),
    "rotor_inertia_mismatch": ("rotor_inertia_mismatch:joint_3:inertia=1.2", "mod3"),
    "stiffness_mismatch": ("stiffness_mismatch:joint_2:stiffness=0.85", "mod3"),
    "damping_mismatch": ("damping_mismatch:joint_2:damping=1.5", "mod3"),
    "spline_inertia": ("spline_inertia", "mod1"),
    "inertia_coupling": ("inertia_coupling", "mod2"),
    "joint_spring": ("joint_spring:joint_2:stiffness=80,rest=0.4", "mod3"),
    "counterbalance": ("counterbalance:joint_2:torque=35/12/-8/3", "mod3"),
    "degressive_friction": ("degressive_friction:joint_2:torque=12,speed=0.3", "mod3"),
    "wrist_coupling": ("wrist_coupling:joint_3:dry=4,viscous=3,inertia=0.2", "mod3"),
    "joint_zero": ("joint_zero:joint_2:offset=0.05", "mod3"),
    "asymmetric_friction": ("asymmetric_friction:joint_2:asymmetry=0.3", "mod3"),
    "gravity_compensation": (
        "gravity_compensation:share=0.4,channels=joint_torque+motor_torque",
        "mod3",
    ),
    "carried_weight": ("carried_weight:joint_2:mass=3,position=0.05/-0.02/0.1", "mod3"),
    "load": ("load:joint_2:mass=6,position=0.05/-0.02/0.1", "mod3"),
    "thermal_friction": ("thermal_friction:joint_2:change=-0.3", "mod3"),
}


def random_motion(
    robot: Robot, rng: np.random.Generator, dof: int | None = None
) -> dict[str, np.ndarray]:
    """A motion as of an excitation: deflections of a milliradian, velocities of half a radian a
    second."""
    n = robot.n
    q, dq, ddq = rng.uniform(-1, 1, n), rng.uniform(-0.8, 0.8, n), rng.uniform(-3, 3, n)
    small = rng.uniform(-1, 1, (3, n)) * [[1e-3], [0.02], [0.5]]
    motion = {
        name: np.append(a, a + b)
        for name, a, b in zip(("x", "dx", "ddx"), (q, dq, ddq), small, strict=True)
    }
    motion |= {name: rng.uniform(-200, 200, n) for name in CHANNELS[3:7]}
    return motion


def law_function(robot: Robot, instances: list[EffectInstance], model: str = "mod3") -> ca.Function:
    """(channels, states of effects) -> what effects add to link, drive and motor (n,) each, and
    rates of the states."""
    equations = ArmEquations(robot, model)
    effect_set = EffectSet(instances, robot, DURATION)
    sizes = {name: equations.dof if name.endswith("x") else robot.n for name in CHANNELS}
    symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    velocities = {"link": symbols["dx"][: robot.n], "motor": symbols["dx"][robot.n :]}
    total, rates = effect_set.contribution(
        SymbolicMotion(equations, **symbols, sign=lambda side, i: ca.sign(velocities[side][i]))
    )
    outputs = ca.substitute(
        [total.link, total.drive, total.motor, rates],
        [effect_set.p, equations.Psi],
        [ca.DM(effect_set.numbers()), ca.DM(equations.nominal)],
    )
    return ca.Function("law", [*symbols.values(), effect_set.z], outputs)


def contribution(
    robot: Robot,
    instances: list[EffectInstance],
    motion: dict[str, np.ndarray],
    z: np.ndarray | None = None,
    model: str = "mod3",
) -> dict[str, np.ndarray]:
    """What effects add to the residuals at one instant, (n,) each, and the rates of their
    states."""
    function = law_function(robot, instances, model)
    z = np.zeros(function.numel_in(len(CHANNELS))) if z is None else z
    values = function(*(motion.get(name, 0.0) for name in CHANNELS), z)
    return {
        name: np.array(v).ravel()
        for name, v in zip(("link", "drive", "motor", "rates"), values, strict=True)
    }
