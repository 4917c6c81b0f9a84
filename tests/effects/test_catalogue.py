"""The catalogue of effects: found by its files, read from text, carried by arm files, used from the
command line."""

import json
import sys

import numpy as np
import pytest

import elastic_arm.effects.library as package
from elastic_arm.effects import (
    EFFECTS,
    EffectInstance,
    Role,
    Scope,
    from_dict,
    parse,
    robot_effects,
)
from elastic_arm.effects.catalogue import discover
from elastic_arm.errors import EffectError
from elastic_arm.recording import read_recording
from elastic_arm.robot import load_robot, save_robot
from tests.helpers.command_line import run
from tests.helpers.effect_samples import INSTANCES, contribution, random_motion

OF_A_NEW_EFFECT = """
from elastic_arm.effects.effect import Effect
from elastic_arm.effects.parameters import Parameter

EFFECT = Effect(
    id="magnetic_hand",
    formula="A q",
    description="A magnet pulls.",
    signature="The link residual follows the angle.",
    law=lambda motion, i, p: motion.at(i, link=p["pull"] * motion.q[i]),
    parameters=(Parameter("pull", "Nm/rad", 0.0, 10.0, neutral=0.0),),
    sides=("link",),
)
"""


@pytest.fixture(scope="module")
def arm():
    return load_robot(None)


def test_adding_an_effect_is_adding_a_file(tmp_path, monkeypatch, arm):
    """A file put beside the others is in the catalogue, and its law acts."""
    (tmp_path / "magnetic_hand.py").write_text(OF_A_NEW_EFFECT, encoding="utf-8")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    found = discover()
    sys.modules.pop("elastic_arm.effects.library.magnetic_hand")
    assert set(found) == set(EFFECTS) | {"magnetic_hand"}
    motion = random_motion(arm, np.random.default_rng(0))
    law = contribution(
        arm, [EffectInstance(found["magnetic_hand"], "joint_2", {"pull": 4.0})], motion
    )
    assert law["link"][1] == pytest.approx(4.0 * motion["x"][1])


def test_two_files_of_one_id_are_refused(tmp_path, monkeypatch):
    """An id taken twice is named."""
    text = OF_A_NEW_EFFECT.replace("magnetic_hand", "payload")
    (tmp_path / "another_payload.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    with pytest.raises(EffectError, match="payload"):
        discover()
    sys.modules.pop("elastic_arm.effects.library.another_payload")


@pytest.mark.parametrize("effect", sorted(INSTANCES))
def test_text_and_data_are_read_back(arm, effect):
    """An effect written as text or as plain data is read back as it was."""
    instance = parse(INSTANCES[effect][0], arm)
    assert instance.effect is EFFECTS[effect]
    for again in (
        parse(str(instance), arm),
        from_dict(json.loads(json.dumps(instance.to_dict())), arm),
    ):
        assert again.to_dict() == instance.to_dict()


def test_arm_files_carry_effects(arm, tmp_path):
    """Effects listed in an arm file are saved and loaded with it."""
    instances = [parse(text, arm) for text, _ in INSTANCES.values()]
    save_robot(arm.with_(effects=tuple(a.to_dict() for a in instances)), tmp_path / "arm.yaml")
    loaded = robot_effects(load_robot(tmp_path / "arm.yaml"))
    assert [a.to_dict() for a in loaded] == [a.to_dict() for a in instances]


def test_parameters_say_what_a_search_needs():
    """Every parameter has a unit and a plausible range; what is linear has a neutral value, or acts
    by its inverse."""
    for effect in EFFECTS.values():
        for p in effect.parameters:
            assert p.unit and p.low < p.high and p.low > p.above
            if p.role is Role.LINEAR and p.inverse:
                assert p.neutral is None and p.low > 0.0
            elif p.role is Role.LINEAR:
                assert p.neutral is not None and p.value_of(0.0) == p.neutral
            elif p.role is Role.PHASE:
                assert effect.parameters[0].role is Role.LINEAR


def test_a_gain_that_would_be_all_of_a_torque_is_infinite():
    """Where the model predicts no torque for a joint, all that was measured fits as a gain: too
    large to be one."""
    assert EFFECTS["motor_torque_gain"].parameter("gain").value_of(1.0) == float("inf")


def test_candidates_cover_every_place_and_choice(arm):
    """The candidates of an effect sit on all joints it can sit on, in all its choices."""
    for effect in EFFECTS.values():
        candidates = list(effect.candidates(arm))
        joints = {c.joint for c in candidates}
        expected = {
            Scope.EACH: set(arm.joint_names),
            Scope.LAST: {arm.joint_names[-1]},
            Scope.BUT_LAST: set(arm.joint_names[:-1]),
            Scope.ARM: {None},
            Scope.EACH_OR_ARM: {None, *arm.joint_names},
        }[effect.scope]
        assert joints == expected
        assert len({str(c) for c in candidates}) == len(candidates)
    assert len(list(EFFECTS["coulomb_friction"].candidates(arm))) == 6


def test_a_fit_may_find_less_than_a_real_arm_has(arm):
    """A negative payload, which says that the nominal arm is too heavy, can be made, saved and
    loaded."""
    lighter = EffectInstance(EFFECTS["payload"], None, {"mass": -2.0})
    assert from_dict(lighter.to_dict(), arm).parameters["mass"] == -2.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("payload:mass=-5", ["payload: mass is -5 kg", "Give at least 0 kg"]),
        ("coulomb_friction:joint_1:torque=-3", ["torque is -3 Nm"]),
        ("stribeck_friction:joint_1:torque=-3,speed=0.1", ["torque is -3 Nm"]),
        ("viscous_friction:joint_1:coefficient=-1", ["coefficient is -1 Nm s/rad"]),
        ("load_dependent_friction:joint_1:coefficient=-0.1", ["coefficient is -0.1"]),
        ("hysteresis:joint_1:torque=-1,width=1e-4", ["torque is -1 Nm"]),
        ("backlash:joint_1:half_gap=-1e-4", ["half_gap is -0.0001 rad"]),
        ("damping_mismatch:joint_1:damping=-0.5", ["damping is -0.5"]),
        ("columb_friction:joint_1:torque=1", ["Did you mean coulomb_friction", "payload"]),
        ("coulomb_friction:joint_9:torque=1", ["joint_9", "joint_1, joint_2, joint_3"]),
        ("coulomb_friction:torque=1", ["needs a joint", "joint_2"]),
        ("coulomb_friction:joint_1:torq=1", ["torq", "torque, side"]),
        ("coulomb_friction:joint_1", ["lacks", "torque"]),
        ("coulomb_friction:joint_1:torque=much", ["much", "Nm"]),
        ("coulomb_friction:joint_1:torque=nan", ["nan", "number"]),
        ("coulomb_friction:joint_1:torque", ["NAME=VALUE"]),
        ("coulomb_friction:joint_1:torque=1,side=top", ["top", "motor, link"]),
        ("coulomb_friction:joint_1:torque=1:more", ["cannot read"]),
        ("hysteresis:joint_1:torque=1,width=0", ["width", "above 0"]),
        ("payload:mass=5,position=0/0", ["position", "3 numbers"]),
        ("payload:joint_1:mass=5", ["joint_1", "joint_3"]),
        ("load:joint_3:mass=5", ["cannot act on joint_3", "joint_1, joint_2"]),
        ("base_tilt:joint_1:x=0.1", ["whole arm"]),
        ("spline_inertia:size=2", ["no free parameter"]),
        (
            "time_delay:joint_1:delay=0.001,channels=joint_torque+thermometer",
            ["thermometer", "link_encoder"],
        ),
    ],
)
def test_errors_list_what_would_be_valid(arm, text, words):
    """An effect that cannot be read, or that no arm has, is refused with what is wrong and what is
    valid."""
    with pytest.raises(EffectError) as caught:
        parse(text, arm)
    for word in words:
        assert word in str(caught.value)


def test_the_command_writes_a_bag(tmp_path):
    """`elastic-arm simulate` makes a bag with both sides, the same bag for the same seed, and JSON
    on request."""
    common = ("--duration", 0.5, "--effect", "coulomb_friction:joint_2:torque=13.9", "--json")
    seeds = {"a": 1, "b": 1, "c": 2}
    results = [
        run("simulate", "--out", tmp_path / name, "--seed", seed, *common)
        for name, seed in seeds.items()
    ]
    assert [r.exit_code for r in results] == [0, 0, 0], results[0].output
    said = json.loads(results[0].stdout)
    assert said["samples"] == 501 and said["effects"][0]["parameters"]["torque"] == 13.9
    a, b, c = (read_recording(tmp_path / name).samples() for name in "abc")
    assert np.array_equal(a.tau_J, b.tau_J) and not np.array_equal(a.tau_J, c.tau_J)
    assert a.q.shape == a.tau_m.shape == (501, 3)


def test_the_command_lists_the_catalogue():
    """`--list-effects` shows every effect."""
    result = run("simulate", "--list-effects")
    assert result.exit_code == 0
    assert all(effect in result.stdout for effect in EFFECTS)
