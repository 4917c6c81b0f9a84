"""Effects of controllers: their laws, and how they change a simulated arm's controller."""

import casadi as ca
import pytest

from elastic_arm.effects import EFFECTS, SymbolicMotion, parse
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import ControllerEffect
from elastic_arm.errors import EffectError
from elastic_arm.robot import JointController, Robot, load_robot
from elastic_arm.simulation import SimulationSettings, Simulator

ELECTRIC = ("supply_sag", "torque_constant")  # of controllers whose duty has a limit
OWN = [
    e.id
    for e in EFFECTS.values()
    if isinstance(e, ControllerEffect) and e.parameters[0].neutral is not None
]
KP = 30.0
KD = 2.0


def controlled(**numbers: object) -> Robot:
    drive = JointController(**{"kp": KP, "kd": KD, **numbers})  # type: ignore[arg-type]
    return load_robot(None).with_joint("joint_2", controller=drive)


def law(robot: Robot, text: str) -> dict[str, float]:
    """What an effect adds to the motor residual of joint 2 at q = 0.3, dq = 0.7, tau_m = 5, dr =
    0.4."""
    equations = ArmEquations(robot)
    instance = parse(text, robot)
    dof = equations.dof
    n = robot.n
    x = ca.DM.zeros(dof)
    dx = ca.DM.zeros(dof)
    x[1] = 0.3
    x[n + 1] = 0.3
    dx[1] = 0.7
    dx[n + 1] = 0.7
    zero = ca.DM.zeros(n)
    one = ca.DM.ones(n)
    drive = robot.joints[1].controller
    assert drive is not None
    kp, kd, _ = drive.gains
    known = {"r": 0.5, "dr": 0.4, "kp": kp, "kd": kd, "fed": 0.0, "stall": drive.stall or 0.0}
    torques = [ca.SX(v) for v in (zero, 5.0 * one, zero, zero)]
    motion = SymbolicMotion(
        equations,
        *(ca.SX(v) for v in (x, dx, zero)),
        *torques,
        sign=lambda s, i: 0.0,
        **{name: ca.SX(value * one) for name, value in known.items()},
    )
    added = instance.effect.law(motion, 1, {**instance.parameters, "integral": ca.SX(0.2)})
    return {side: float(ca.DM(getattr(added, side)[1])) for side in ("link", "drive", "motor")}


@pytest.mark.parametrize(
    ("text", "numbers", "wanted"),
    [
        # 5 Nm are kp's and kd's -0.7 kd, so kp makes 6.4 Nm.
        ("position_gain:joint_2:gain=1.25", {}, -0.25 * (5.0 + 0.7 * KD)),
        ("velocity_gain:joint_2:gain=1.5", {}, -0.5 * KD * -0.7),
        ("velocity_gain:joint_2:gain=1.5", {"mode": "both"}, -0.5 * KD * (0.4 - 0.7)),
        ("command_delay:joint_2:delay=0.02", {}, 0.02 * KP * 0.4),
        ("command_delay:joint_2:delay=0.02", {"torque": 4.0}, 0.0),  # at its limit no gain matters
        # Of the angles, 0.2 kp - 0.7 kd = 4.6 Nm are made.
        ("torque_saturation:joint_2:torque=3.0", {}, 1.6),
        ("torque_saturation:joint_2:torque=5.0", {}, 0.0),
        ("position_dead_band:joint_2:half_width=0.05", {}, 0.05 * KP),
        ("position_dead_band:joint_2:half_width=0.25", {}, 0.2 * KP),
        ("integral_gain:joint_2:ki=7.0", {}, -0.2 * 7.0),
        # Of the angles, 6 Nm are asked for, half of full duty.
        ("supply_sag:joint_2:share=0.2", {"stall": 12.0}, 0.2 * 12.0 * 0.5**2),
        ("supply_sag:joint_2:share=0.2", {"stall": 4.0}, 0.2 * 4.0),
        ("torque_constant:joint_2:gain=1.25", {"stall": 12.0}, -0.25 * 5.0),
        # At full duty what the firmware asks for does not count, the back-EMF does.
        ("position_gain:joint_2:gain=1.25", {"stall": 4.0}, 0.0),
        ("command_delay:joint_2:delay=0.02", {"stall": 4.0}, 0.0),
        ("velocity_gain:joint_2:gain=1.5", {"stall": 4.0}, -0.5 * KD * -0.7),
        ("torque_saturation:joint_2:torque=2.0", {"stall": 4.0}, 4.0 - 0.7 * KD - 2.0),
    ],
)
def test_laws_are_what_the_stated_controller_makes_more(
    text: str, numbers: dict[str, object], wanted: float
) -> None:
    """Stated less true torque, in the motor's row alone."""
    found = law(controlled(**numbers), text)
    assert found == {
        "link": 0.0,
        "drive": 0.0,
        "motor": pytest.approx(wanted, rel=1e-12, abs=1e-12),
    }


@pytest.mark.parametrize("effect", OWN)
def test_at_the_neutral_value_nothing_is_added(effect: str) -> None:
    """A gain of one and a delay of none are no effect."""
    (parameter,) = EFFECTS[effect].parameters
    text = f"{effect}:joint_2:{parameter.name}={parameter.neutral}"
    stated = {"stall": 12.0} if effect in ELECTRIC else {}
    assert law(controlled(**stated), text)["motor"] == 0.0


def test_electrics_are_sought_only_where_they_are_stated() -> None:
    """Of a controller without a limit of its duty no supply sags; the error says what to state."""
    with pytest.raises(EffectError, match=r"states no electrics of joint_2.*dcmotor"):
        law(controlled(), "supply_sag:joint_2:share=0.2")


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ("position_gain:joint_2:gain=1.25", {"kp": 1.25 * KP}),
        ("velocity_gain:joint_2:gain=0.5", {"kd": 0.5 * KD}),
        ("command_delay:joint_2:delay=0.02", {"delay": 0.02}),
        ("torque_saturation:joint_2:torque=3.0", {"torque": 3.0}),
        ("position_dead_band:joint_2:half_width=0.05", {"dead_band": 0.05}),
        ("integral_gain:joint_2:ki=7.0", {"ki": 7.0}),
    ],
)
def test_a_simulated_arm_is_driven_by_the_changed_controller(
    text: str, changed: dict[str, float]
) -> None:
    """The simulator takes the true controller, not that of the description."""
    robot = controlled()
    simulator = Simulator(robot, SimulationSettings(effects=[parse(text, robot)]))
    wanted = Simulator(controlled(**changed)).controller
    for name in ("kp", "kd", "ki", "delay", "limit", "dead_band"):
        assert getattr(simulator.controller, name)[1] == getattr(wanted, name)[1]


def test_without_a_controller_the_effect_is_refused_with_the_block_to_write() -> None:
    """The error names the joint and the entry of the arm file."""
    robot = load_robot(None)
    with pytest.raises(
        EffectError,
        match=r"no controller for joint_1.*`controller: \{joint_1: \{kp: 30, kd: 0.5\}\}`",
    ):
        Simulator(
            robot, SimulationSettings(effects=[parse("position_gain:joint_1:gain=1.2", robot)])
        )
