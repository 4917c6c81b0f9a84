"""Every law of the catalogue against its closed form, written out here."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.effects.effect import ControllerEffect
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.errors import EffectError
from elastic_arm.robot import Inertia, Robot, load_robot
from elastic_arm.robot.kinematics import lumped
from tests.helpers.effect_samples import DURATION, INSTANCES, contribution, random_motion

PAGE = (Path(__file__).parents[2] / "docs" / "contract.md").read_text(encoding="utf-8")
CATALOGUE = PAGE.split("## Effects", 1)[1].split("\n## ", 1)[0]
# What no value of a parameter turns off.
NEVER_NEUTRAL = {
    "bearing_compliance",
    "joint_elasticity",
    "torque_lowpass",
    "spline_inertia",
    "inertia_coupling",
}
# Of arms that state controllers, which have tests of their own.
CONTROLLERS = {effect.id for effect in EFFECTS.values() if isinstance(effect, ControllerEffect)}
CONTRACT = set(re.findall(r"^\| `(\w+)` \|", CATALOGUE, re.MULTILINE))

# id -> (motion m at joint i, transmission g, parameters p) -> expected residuals of that joint.
CLOSED_FORMS = {
    "viscous_friction": lambda m, g, p: {"motor": p["coefficient"] * m.dtheta},
    "coulomb_friction": lambda m, g, p: {"motor": p["torque"] * np.sign(m.dtheta)},
    "stribeck_friction": lambda m, g, p: {
        "motor": p["torque"] * np.exp(-((m.dtheta / p["speed"]) ** 2)) * np.sign(m.dtheta)
    },
    "load_dependent_friction": lambda m, g, p: {
        "motor": p["coefficient"] * abs(m.tau_J) * np.sign(m.dtheta)
    },
    "nonlinear_stiffness": lambda m, g, p: {"drive": p["cubic"] * m.d**3},
    "backlash": lambda m, g, p: {
        "drive": g.stiffness * (np.sign(m.d) * max(abs(m.d) - p["half_gap"], 0.0) - m.d)
    },
    "transmission_error": lambda m, g, p: {
        "drive": g.stiffness
        * p["amplitude"]
        * np.sin(2 * g.harmonic_drive_ratio * m.theta + p["phase"])
        + g.damping
        * p["amplitude"]
        * 2
        * g.harmonic_drive_ratio
        * np.cos(2 * g.harmonic_drive_ratio * m.theta + p["phase"])
        * m.dtheta,
        "motor": m.tau_J
        * p["amplitude"]
        * 2
        * g.harmonic_drive_ratio
        * np.cos(2 * g.harmonic_drive_ratio * m.theta + p["phase"]),
    },
    "torque_ripple": lambda m, g, p: {
        "motor": -p["amplitude"] * np.sin(p["order"] * g.r_tot * m.theta + p["phase"])
    },
    "motor_torque_gain": lambda m, g, p: {"motor": m.tau_m - m.tau_m / p["gain"]},
    "joint_torque_gain": lambda m, g, p: (
        dict.fromkeys(("link", "drive"), m.tau_J - m.tau_J / p["gain"])
        | {"motor": -(m.tau_J - m.tau_J / p["gain"])}
    ),
    "motor_torque_offset": lambda m, g, p: {"motor": p["offset"]},
    "joint_torque_offset": lambda m, g, p: {
        "link": p["offset"],
        "drive": p["offset"],
        "motor": -p["offset"],
    },
    "encoder_offset": lambda m, g, p: {"drive": g.stiffness * p["offset"]},
    "encoder_eccentricity": lambda m, g, p: {
        "drive": g.stiffness * p["amplitude"] * np.sin(m.q + p["phase"])
        + g.damping * p["amplitude"] * np.cos(m.q + p["phase"]) * m.dq
    },
    "rotor_inertia_mismatch": lambda m, g, p: {
        "motor": (p["inertia"] - 1)
        * m.ddtheta
        * (
            g.rotor.izz * g.r_tot**2
            + g.wave_generator.izz * g.harmonic_drive_ratio**2
            + g.spline.izz
        )
    },
    "stiffness_mismatch": lambda m, g, p: {"drive": (p["stiffness"] - 1) * g.stiffness * m.d},
    "damping_mismatch": lambda m, g, p: {
        "drive": (p["damping"] - 1) * g.damping * (m.dtheta - m.dq)
    },
    "joint_spring": lambda m, g, p: {"link": p["stiffness"] * (m.q - p["rest"])},
    "counterbalance": lambda m, g, p: {"link": np.polynomial.Polynomial((0, 0, *p["torque"]))(m.q)},
    "degressive_friction": lambda m, g, p: {"motor": p["torque"] * np.tanh(m.dtheta / p["speed"])},
}


@pytest.fixture(scope="module")
def arm():
    return load_robot(None)


class At:
    """A motion at one joint."""

    def __init__(self, motion, i, n):
        for name, key in (("", "x"), ("d", "dx"), ("dd", "ddx")):
            setattr(self, f"{name}q", motion[key][i])
            setattr(self, f"{name}theta", motion[key][n + i])
        self.tau_J = motion["tau_J"][i]
        self.tau_m = motion["tau_m"][i]
        self.d = self.theta - self.q


def test_the_catalogue_holds_the_contracts_effects():
    """The ids of docs/contract.md and no other, each with words, formula and sides."""
    assert set(EFFECTS) == CONTRACT
    for effect in EFFECTS.values():
        assert effect.formula and effect.description and effect.signature and effect.sides
        assert all(other.effect in EFFECTS for other in effect.confusions)
        assert set(effect.sides) <= {"link", "drive", "motor"}


@pytest.mark.parametrize("effect", CLOSED_FORMS)
def test_law_meets_its_closed_form(arm, effect):
    """At random motions the law adds to the residuals what the contract's formula says, and to no
    other joint."""
    instance = parse(INSTANCES[effect][0], arm)
    (i,) = instance.joint_indices(arm)
    for seed in range(5):
        motion = random_motion(arm, np.random.default_rng(seed))
        expected = CLOSED_FORMS[effect](
            At(motion, i, arm.n), arm.joints[i].transmission, instance.parameters
        )
        found = contribution(arm, [instance], motion)
        for side in ("link", "drive", "motor"):
            row = np.zeros(arm.n)
            row[i] = expected.get(side, 0.0)
            assert np.allclose(found[side], row, rtol=1e-12, atol=1e-12), (side, found[side], row)


@pytest.mark.parametrize(
    "effect", ["viscous_friction", "coulomb_friction", "stribeck_friction", "degressive_friction"]
)
def test_friction_acts_on_the_chosen_side(arm, effect):
    """Friction of the link side follows the link's velocity and shows in the link equation."""
    instance = parse(INSTANCES[effect][0]).with_parameters(side="link")
    (i,) = instance.joint_indices(arm)
    motion = random_motion(arm, np.random.default_rng(3))
    motion["dx"][i] = -motion["dx"][arm.n + i]
    at = At(motion, i, arm.n)
    at.dtheta = at.dq
    expected = CLOSED_FORMS[effect](at, arm.joints[i].transmission, instance.parameters)["motor"]
    found = contribution(arm, [instance], motion)
    assert found["link"][i] == pytest.approx(expected) and not found["motor"].any()
    assert instance.sides == ("link",)


@pytest.mark.parametrize("effect", sorted(CONTRACT - NEVER_NEUTRAL - CONTROLLERS))
def test_no_effect_at_the_neutral_value(arm, effect):
    """With its parameters at "no effect" a law adds nothing."""
    motion = random_motion(arm, np.random.default_rng(0))
    for instance in EFFECTS[effect].candidates(arm):
        if effect == "wrist_coupling" and instance.joint == arm.joint_names[0]:
            continue  # which shares no motor with one before it
        stated = [p for p in instance.effect.parameters if p.neutral is not None]
        neutral = {p.name: p.neutral if p.size == 1 else (p.neutral,) * p.size for p in stated}
        assert neutral
        found = contribution(arm, [instance.with_parameters(**neutral)], motion)
        assert all(np.abs(found[side]).max() < 1e-10 for side in ("link", "drive", "motor"))


@pytest.mark.parametrize("side", ["motor", "link"])
def test_thermal_friction_scales_the_friction_of_its_joint_and_side(arm, side):
    """It adds r (t - t_mid)/T times all friction there, at the begin, in the middle and at the end
    of a run."""
    texts = [
        f"coulomb_friction:joint_2:torque=10,side={side}",
        f"viscous_friction:joint_2:coefficient=5,side={side}",
    ]
    other = parse("coulomb_friction:joint_1:torque=7")
    friction = [parse(text, arm) for text in texts]
    warm = parse(f"thermal_friction:joint_2:change=-0.4,side={side}", arm)
    motion = random_motion(arm, np.random.default_rng(2))
    alone = contribution(arm, [*friction, other], motion)
    for progress in (0.0, 0.5, 1.0):
        found = contribution(
            arm, [*friction, other, warm], motion, z=np.array([progress * DURATION])
        )
        expected = alone[side].copy()
        expected[1] *= 1 - 0.4 * (progress - 0.5)
        assert np.allclose(found[side], expected)
        assert found["rates"] == [1.0]


@pytest.mark.parametrize("side", ["motor", "link"])
def test_asymmetric_friction_is_larger_in_one_direction(arm, side):
    """All friction of its joint and side is 1 + a times as large forwards, 1 - a times backwards;
    none elsewhere."""
    texts = [
        f"coulomb_friction:joint_2:torque=10,side={side}",
        f"viscous_friction:joint_2:coefficient=5,side={side}",
    ]
    friction = [*(parse(text, arm) for text in texts), parse("coulomb_friction:joint_1:torque=7")]
    skewed = parse(f"asymmetric_friction:joint_2:asymmetry=0.3,side={side}", arm)
    for seed in range(4):
        motion = random_motion(arm, np.random.default_rng(seed))
        expected = contribution(arm, friction, motion)[side]
        expected[1] *= 1 + 0.3 * np.sign(motion["dx"][1 if side == "link" else arm.n + 1])
        assert np.allclose(contribution(arm, [*friction, skewed], motion)[side], expected)


def test_a_joint_zero_turns_what_hangs_on_the_joint(arm):
    """Both encoders read `offset` too much: the torques are those of the arm at the angles less it,
    K and D apart."""
    motion = random_motion(arm, np.random.default_rng(0))
    model = build_model(arm, engine="numpy")
    turned = motion["x"] - 0.05 * np.array([0, 1, 0, 0, 1, 0])
    there, here = (
        model.inverse_dynamics(*(v[None] for v in (x, motion["dx"], motion["ddx"])))[0]
        for x in (turned, motion["x"])
    )
    found = contribution(arm, [parse("joint_zero:joint_2:offset=0.05")], motion)
    assert np.allclose(found["link"], (there - here)[:3]) and np.abs(found["link"][1]) > 1.0
    assert np.allclose(found["motor"], (there - here)[3:]) and not found["drive"].any()


def test_a_joint_zero_is_the_turned_geometry_of_a_description(arm):
    """An arm file whose DH offset is smaller by the zero moves as the arm with the effect."""
    joint = arm.joints[1]
    row = replace(joint.dh, offset=joint.dh.offset - 0.05)
    built = arm.with_joint("joint_2", dh=row, after=row.placement)
    motion = random_motion(arm, np.random.default_rng(1))
    state = [motion[name][None] for name in ("x", "dx", "ddx")]
    true, nominal = (
        build_model(robot, engine="numpy").inverse_dynamics(*state)[0] for robot in (built, arm)
    )
    found = contribution(arm, [parse("joint_zero:joint_2:offset=0.05")], motion)
    assert np.allclose(np.append(found["link"], found["motor"]), true - nominal)


@pytest.mark.parametrize("joint", [None, "joint_2"])
def test_gravity_compensation_takes_its_share_of_the_weight(arm, joint):
    """Every equation that holds the torque lacks the share of gravity; tau_J counts reversed for
    the motor."""
    motion = random_motion(arm, np.random.default_rng(0))
    rest = np.zeros((1, 6))
    still = np.tile(motion["x"][None, :3], 2)
    weight = 0.4 * build_model(arm, engine="numpy").inverse_dynamics(still, rest, rest)[0, :3]
    if joint:
        weight *= [0, 1, 0]
    place = f"gravity_compensation:{joint}:share=0.4" if joint else "gravity_compensation:share=0.4"
    of = {
        c: contribution(arm, [parse(f"{place},channels={c}_torque")], motion)
        for c in ("joint", "motor")
    }
    assert np.allclose(of["motor"]["motor"], -weight) and not (
        of["motor"]["link"].any() or of["motor"]["drive"].any()
    )
    assert np.allclose(of["joint"]["link"], -weight) and np.allclose(of["joint"]["drive"], -weight)
    assert np.allclose(of["joint"]["motor"], weight) and np.abs(weight).max() > 10.0


def test_a_load_is_a_link_with_a_point_mass(arm):
    """An arm whose second link carries the mass needs the torques of the model with the effect."""
    link = lumped(
        [arm.joints[1].link, Inertia(6.0, np.array([0.05, -0.02, 0.1]), np.zeros((3, 3)))]
    )
    motion = random_motion(arm, np.random.default_rng(0))
    state = [motion[name][None] for name in ("x", "dx", "ddx")]
    heavy = arm.with_joint("joint_2", link=link)
    true, nominal = (
        build_model(robot, engine="numpy").inverse_dynamics(*state)[0, :3] for robot in (heavy, arm)
    )
    found = contribution(arm, [parse("load:joint_2:mass=6,position=0.05/-0.02/0.1")], motion)[
        "link"
    ]
    assert np.allclose(found, true - nominal) and found[2] == pytest.approx(0.0, abs=1e-12)


def test_an_effect_in_time_needs_a_run_that_ends(arm):
    """Without a duration there is no middle of the run: the effect is refused with what to do."""
    with pytest.raises(EffectError, match="Simulate a trajectory"):
        EffectSet([parse("thermal_friction:joint_2:change=0.2", arm)], arm)


def test_hysteresis_rate_is_the_contracts(arm):
    """z' = (d' - |d'| z/2 - d' |z|/2) / w_h, and H z is added to tau_J."""
    instance = parse(INSTANCES["hysteresis"][0])
    for seed, z in enumerate((-0.9, -0.2, 0.0, 0.4, 1.0)):
        motion = random_motion(arm, np.random.default_rng(seed))
        d_rate = motion["dx"][4] - motion["dx"][1]
        found = contribution(arm, [instance], motion, np.array([z]))
        assert found["drive"][1] == pytest.approx(5 * z)
        assert found["rates"][0] == pytest.approx(
            (d_rate - abs(d_rate) * z / 2 - d_rate * abs(z) / 2) / 1e-4
        )


def inverse_dynamics(robot, motion, model="mod3"):
    model = build_model(robot, model, engine="numpy")
    return model.inverse_dynamics(*(motion[name][None] for name in ("x", "dx", "ddx")))[0]


def altered_link(robot, i, mass, com, about_com):
    from elastic_arm.robot.description import Inertia

    return robot.with_joint(robot.joint_names[i], link=Inertia(mass, com, about_com))


def with_payload(robot: Robot, mass, position):
    """The last link with a point mass, by the parallel-axis theorem about the common centre of
    mass."""
    link = robot.joints[-1].link
    total = link.mass + mass
    com = (link.mass * link.com + mass * np.asarray(position)) / total
    inertia = link.inertia.copy()
    for m, p in ((link.mass, link.com), (mass, np.asarray(position))):
        r = p - com
        inertia = inertia + m * (r @ r * np.eye(3) - np.outer(r, r))
    return altered_link(robot, robot.n - 1, total, com, inertia)


def rotation(axis, angle):
    c = np.cos(angle)
    s = np.sin(angle)
    j, k = [(1, 2), (2, 0)][axis]
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = c
    matrix[j, k] = -s
    matrix[k, j] = s
    return matrix


def truly(effect, robot, p):
    """The arm that truly has the effect, changed in its description."""
    if effect == "payload":
        return with_payload(robot, p["mass"], p["position"])
    if effect == "link_inertia_mismatch":
        link = robot.joints[1].link
        inertia = link.inertia * p["mass"] * p["inertia"]
        return altered_link(robot, 1, link.mass * p["mass"], link.com + np.array(p["com"]), inertia)
    tilt = np.eye(4)
    tilt[:3, :3] = rotation(0, p["x"]) @ rotation(1, p["y"])
    return robot.with_(base_placement=tilt @ robot.base_placement)


@pytest.mark.parametrize("effect", ["payload", "link_inertia_mismatch", "base_tilt"])
def test_changed_parts_equal_a_changed_description(arm, effect):
    """The law adds exactly what the arm with that part changed has beyond the nominal arm."""
    instance = parse(INSTANCES[effect][0], arm)
    for seed in range(3):
        motion = random_motion(arm, np.random.default_rng(seed))
        found = contribution(arm, [instance], motion)
        true = inverse_dynamics(truly(effect, arm, instance.parameters), motion) - inverse_dynamics(
            arm, motion
        )
        assert np.allclose(np.append(found["link"], found["motor"]), true, rtol=1e-9, atol=1e-9)
        assert np.abs(true).max() > 0.1 and not found["drive"].any()


@pytest.mark.parametrize(
    ("effect", "less", "more"),
    [("spline_inertia", "mod1", "mod2"), ("inertia_coupling", "mod2", "mod3")],
)
def test_model_form_is_the_difference_of_two_models(arm, effect, less, more):
    """The parameter-free effects add what the richer model has, and refuse a model that has it
    already."""
    motion = random_motion(arm, np.random.default_rng(0))
    found = contribution(arm, [parse(effect)], motion, model=less)
    true = inverse_dynamics(arm, motion, more) - inverse_dynamics(arm, motion, less)
    assert np.allclose(np.append(found["link"], found["motor"]), true, atol=1e-9)
    assert np.abs(true).max() > 1e-3
    with pytest.raises(ValueError, match="already"):
        contribution(arm, [parse(effect)], motion, model=more)


def test_a_transmission_error_is_found_in_the_deflection_by_other_laws(arm):
    """Backlash beside a transmission error takes its play from theta + e - q."""
    motion = random_motion(arm, np.random.default_rng(1))
    error = parse("transmission_error:joint_2:amplitude=3e-5")
    play = parse("backlash:joint_2:half_gap=1e-4")
    both = contribution(arm, [play, error], motion)
    alone = contribution(arm, [error], motion)
    at = At(motion, 1, 3)
    gear = arm.joints[1].transmission
    d = at.d + 3e-5 * np.sin(2 * gear.harmonic_drive_ratio * at.theta)
    taken = gear.stiffness * (np.sign(d) * max(abs(d) - 1e-4, 0.0) - d)
    assert both["drive"][1] - alone["drive"][1] == pytest.approx(taken)
