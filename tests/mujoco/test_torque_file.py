"""Torque functions that are written for controllers: those of Pinocchio, in each language."""

import ctypes
import os
import runpy
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.mujoco.torque_file import Language, export_torque
from elastic_arm.robot import Robot, load_robot, to_urdf
from elastic_arm.robot.urdf import parse_urdf
from elastic_arm.simulation.assembly import law_rows
from elastic_arm.simulation.simulator import SIGN_SPEED
from tests.helpers.command_line import run
from tests.helpers.effect_samples import INSTANCES
from tests.helpers.mujoco_arms import random_motion
from tests.robot.test_urdf import random_chain, two_joints

Array = NDArray[np.float64]
Functions = dict[str, Callable[..., Array]]
ENDINGS = {Language.c: "c", Language.python: "py", Language.casadi: "casadi"}
COMPILER = os.environ.get("CC") or shutil.which("cc")
# Effects that the function of a motion holds: acting by a law, without memory, not in the drive.
HELD = [
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "degressive_friction",
    "load_dependent_friction",
    "torque_ripple",
    "payload",
    "load",
    "carried_weight",
    "base_tilt",
    "link_inertia_mismatch",
    "rotor_inertia_mismatch",
    "joint_spring",
    "counterbalance",
    "joint_zero",
]


def written(robot: Robot, language: Language, folder: Path) -> Functions:
    """Write a robot's torque function, and return what a user gets of the file."""
    out = folder / f"arm.{ENDINGS[language]}"
    export_torque(robot, None, out, language=language)
    if language is Language.python:
        module = runpy.run_path(str(out))
        return {
            name: module[name] for name in ("torque", "inverse_dynamics", "gravity", "friction")
        }
    if language is Language.casadi:
        function = ca.Function.load(str(out))

        def of_casadi(name: str) -> Callable[..., Array]:
            def value(*given: Array) -> Array:
                inputs = dict(zip(("q", "dq", "ddq"), given, strict=False))
                return np.array(function(**inputs)[name]).ravel()

            return value

        return {name: of_casadi(name) for name in function.name_out()}
    if COMPILER is None:
        pytest.skip("there is no C compiler")
    library = folder / "arm.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run([COMPILER, *flags, str(out), "-o", str(library), "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))

    def of_c(name: str) -> Callable[..., Array]:
        def value(*given: Array) -> Array:
            tau = np.zeros(robot.n)
            arrays = [np.ascontiguousarray(one, dtype=float) for one in (*given, tau)]
            pointers = [one.ctypes.data_as(ctypes.c_void_p) for one in arrays]
            getattr(loaded, f"arm_{name}")(*pointers)
            return arrays[-1]

        return value

    return {name: of_c(name) for name in ("torque", "inverse_dynamics", "gravity", "friction")}


def with_friction(robot: Robot) -> Robot:
    """Return a rigid arm with motor inertia, and other friction at each joint."""
    joints = tuple(replace(joint, armature=0.3 * (k + 1)) for k, joint in enumerate(robot.joints))
    effects = [
        {"effect": effect, "joint": joint.name, "parameters": {number: size * (k + 1)}}
        for effect, number, size in (
            ("coulomb_friction", "torque", 2.0),
            ("viscous_friction", "coefficient", 0.7),
        )
        for k, joint in enumerate(joints)
    ]
    return robot.with_(joints=joints, effects=tuple(effects))


def configuration(peer: pinocchio.Model, q: Array) -> Array:
    """Return Pinocchio's configuration: a continuous joint's angle as its cosine and sine."""
    angles = [
        [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        for joint, angle in zip(peer.joints[1:], q, strict=True)
    ]
    return np.concatenate(angles)


CHAINS = {
    "two joints": two_joints(),
    "three joints": random_chain(np.random.default_rng(3), 3),
    "six joints": random_chain(np.random.default_rng(6), 6),
    "a slide": two_joints().replace('name="one" type="revolute"', 'name="one" type="prismatic"'),
}


@pytest.mark.parametrize("language", Language)
@pytest.mark.parametrize("arm", CHAINS)
def test_the_torque_is_that_of_pinocchio_and_the_friction(
    arm: str, language: Language, tmp_path: Path
) -> None:
    """Inverse dynamics with armature, gravity, and friction of every joint, to 1e-9."""
    robot = with_friction(parse_urdf(CHAINS[arm]))
    functions = written(robot, language, tmp_path)
    peer = pinocchio.buildModelFromXML(CHAINS[arm])
    peer.armature = np.array([joint.armature for joint in robot.joints])
    data = peer.createData()
    size = np.arange(1.0, robot.n + 1.0)
    for q, dq, ddq in zip(*random_motion(robot.n, 5), strict=True):
        place = configuration(peer, q)
        rigid = pinocchio.rnea(peer, data, place, dq, ddq)
        held = pinocchio.computeGeneralizedGravity(peer, data, place)
        rough = 2.0 * size * np.tanh(dq / SIGN_SPEED) + 0.7 * size * dq
        largest = np.abs(rigid).max()
        near = {"rtol": 1e-9, "atol": 1e-9 * largest}
        np.testing.assert_allclose(functions["inverse_dynamics"](q, dq, ddq), rigid, **near)
        np.testing.assert_allclose(functions["gravity"](q), held, **near)
        np.testing.assert_allclose(functions["friction"](q, dq, ddq), rough, **near)
        np.testing.assert_allclose(functions["torque"](q, dq, ddq), rigid + rough, **near)


@pytest.mark.parametrize("language", Language)
def test_the_motors_of_an_elastic_arm_turn_with_its_links(
    language: Language, tmp_path: Path
) -> None:
    """Both rows of each joint together, where the drive is not wound; gravity is Pinocchio's."""
    robot = load_robot()
    functions = written(robot, language, tmp_path)
    motion = random_motion(robot.n, 4)
    rows = build_model(robot).inverse_dynamics(*(np.tile(one, 2) for one in motion))
    expected = rows[:, : robot.n] + rows[:, robot.n :]
    peer = pinocchio.buildModelFromXML(to_urdf(robot))
    data = peer.createData()
    for k, (q, dq, ddq) in enumerate(zip(*motion, strict=True)):
        np.testing.assert_allclose(functions["torque"](q, dq, ddq), expected[k], rtol=1e-9)
        held = pinocchio.computeGeneralizedGravity(peer, data, configuration(peer, q))
        np.testing.assert_allclose(functions["gravity"](q), held, atol=1e-9 * np.abs(held).max())


@pytest.mark.parametrize("effect", HELD)
def test_effects_are_in_the_torque(effect: str, tmp_path: Path) -> None:
    """Each law adds what it adds in a simulation, on a rigid arm and on an elastic one, in all
    languages alike, and at rest as in motion."""
    elastic = load_robot()
    # So stiff that motor and link turn alike.
    for joint in elastic.joints:
        stiff = replace(joint.transmission, stiffness=1e8, damping=0.0)
        elastic = elastic.with_joint(joint.name, transmission=stiff)
    rigid = load_robot().with_(
        joints=tuple(
            replace(joint, transmission=None, armature=20.0) for joint in load_robot().joints
        )
    )
    # Ripple goes by the ratio of a gear, of which a rigid arm has none.
    for robot in (elastic,) if effect == "torque_ripple" else (elastic, rigid):
        instance = parse(INSTANCES[effect][0])
        # Friction that grows with the load is judged beside another one.
        beside = parse(
            "coulomb_friction:joint_2:torque=5,side=link"
            if robot.elastic
            else "coulomb_friction:joint_2:torque=5"
        )
        instances = [instance, beside] if effect == "load_dependent_friction" else [instance]
        arm = robot.with_(effects=tuple(one.to_dict() for one in instances))
        (tmp_path / str(robot.elastic)).mkdir()
        forms = [written(arm, language, tmp_path / str(robot.elastic)) for language in Language]
        motion = random_motion(robot.n, 4)
        # The last one is at rest.
        motion[1][-1] = motion[2][-1] = 0.0
        for sample in zip(*motion, strict=True):
            torques = [one["torque"](*sample) for one in forms]
            expected = simulated(arm, *sample, torques[0])
            scale = np.abs(expected).max()
            for torque in torques:
                np.testing.assert_allclose(torque, expected, rtol=1e-6, atol=1e-6 * scale)


def simulated(robot: Robot, q: Array, dq: Array, ddq: Array, tau_m: Array) -> Array:
    """Return what the equations of a simulation need of each motor, the drives wound by it."""
    n, sides = robot.n, 2 if robot.elastic else 1
    equations = ArmEquations(robot)
    effects = EffectSet(robot_effects(robot), robot)
    law, model = law_rows(equations, effects), build_model(robot)
    x, dx, ddx = (np.tile(one, sides) for one in (q, dq, ddq))
    given = (equations.nominal, effects.numbers(), np.full(2 * n, SIGN_SPEED))

    def rows() -> Array:
        own = model.inverse_dynamics(x[None], dx[None], ddx[None])[0]
        return own + np.array(law(x, dx, ddx, [], tau_m, *given)[0]).ravel()

    if robot.elastic:
        x[n:] += rows()[:n] / 1e8
    return rows().reshape(sides, n).sum(axis=0)


def test_what_is_no_function_of_the_motion_is_left_and_said(tmp_path: Path) -> None:
    """Sensors, drives, memory and time are named with their reasons, in the file too."""
    effects = [
        parse(INSTANCES[name][0]).to_dict()
        for name in ("coulomb_friction", "hysteresis", "motor_torque_gain", "thermal_friction")
    ]
    out = tmp_path / "my arm-1.c"
    done = export_torque(load_robot().with_(effects=tuple(effects)), None, out, language=Language.c)
    reasons = {one.what: one.reason for one in done.left}
    assert "sensors" in reasons["motor_torque_gain"]
    assert "drive" in reasons["hysteresis"] and "recording" in reasons["thermal_friction"]
    assert "coulomb_friction" not in reasons
    text = out.read_text()
    assert "void my_arm_1_torque(const double q[3]" in text
    assert "thermal_friction:joint_2" in text and "joint_3 (rad, Nm)" in text


def test_unknown_motor_inertia_is_noted(tmp_path: Path) -> None:
    """A URDF without rotors gives a torque without them, and says so."""
    out = tmp_path / "arm.py"
    done = export_torque(parse_urdf(two_joints()), None, out, language=Language.python)
    (note,) = done.notes
    assert "motor inertia of one, two" in note and note in " ".join(out.read_text().split())
    known = with_friction(parse_urdf(two_joints()))
    assert not export_torque(known, None, out, language=Language.python).notes


def test_a_torque_function_has_no_base(tmp_path: Path) -> None:
    """`--base` goes with URDF and MJCF alone, and the ending has to be that of the language."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(two_joints())
    out = tmp_path / "arm.c"
    said = run("export", urdf, "--base", urdf, "--out", out)
    assert said.exit_code == 2 and "always a new file" in said.stderr and not out.exists()
    said = run("export", urdf, "--to", "casadi", "--out", out)
    assert said.exit_code == 2 and "extension" in said.stderr and not out.exists()
    said = run("export", urdf, "--to", "c", "--out", out)
    assert said.exit_code == 0 and "motor inertia" in said.stdout
