"""How held-out motion judges one arm against another."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification import identifier_of, identify
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.batch.selection import Trials
from elastic_arm.identification.validation import HeldOut, _described
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot, parse_urdf, to_urdf
from elastic_arm.simulation import simulate
from tests.helpers.motions import trajectory
from tests.helpers.periodic_arm import derivative, link_motion


def test_rows_of_a_joint_that_sticks_do_not_make_its_error_smaller() -> None:
    """Held-out errors of 1 Nm are 1 Nm, also where half of a joint's rows do not count."""
    arm = load_robot(None)
    t = np.arange(1000) / 500.0
    identifier = identifier_of(arm)
    errors = np.random.default_rng(1).choice([-1.0, 1.0], (1000, 3))
    q = np.full((1000, 3), 0.3)
    stuck = np.zeros((1000, 3), dtype=bool)
    stuck[::2, 1] = True
    still = Motion(t, q, 0 * q, 0 * q, q, 0 * q, 0 * q, tau_J=0 * q, tau_m=0 * q, stuck=stuck)
    equations = identifier.choose_equations(still)
    true = equations.base.T @ equations.nominal
    predicted = equations.predict(replace(still, stuck=None), true)
    motion = replace(still, tau_m=predicted["motor"] + errors, tau_J=predicted["drive"] + errors)
    found = HeldOut(equations, {"held out": [motion, motion]}).errors(true)["held out"]
    for side in ("motor", "drive"):
        assert list(found[side].values()) == pytest.approx([1.0] * 3)


def test_robot_yaml_names_motor_inertia_where_it_was_put_back() -> None:
    """An arm with transmissions has rotors, of which nothing is put back."""
    arm = load_robot(None)
    rigid = parse_urdf(to_urdf(arm)).with_armatures()
    notes = []
    for robot, channels in ((arm, ("q", "theta", "tau_m")), (rigid, ("theta", "tau_m"))):
        equations = BaseRegression(
            build_model(robot), frozenset(channels), joints=robot.joint_names
        )
        notes.append(_described(["joint_1"], equations))
    assert ["motor inertia" in note for note in notes] == [False, True]


def test_noise_in_accelerations_does_not_speak_for_small_masses() -> None:
    """With noise of 28 rad/s² half the masses miss less torque than the true ones; averages judge
    rightly."""
    arm = parse_urdf(to_urdf(load_robot(None)))
    t = np.arange(4000) / 500.0
    rng = np.random.default_rng(3)
    q = link_motion(3, t, 4.0, 5, rng)
    dq, ddq = (derivative(q, order, 500.0) for order in (1, 2))
    torque = build_model(arm).inverse_dynamics(q, dq, ddq)
    identifier = identifier_of(arm)
    motor = Side(np.rint(t * 1e9).astype(np.int64), q, None, torque)
    equations = identifier.choose_equations(Recording(arm.joint_names, motor=motor).samples())
    noise = 20.0 * np.diff(rng.standard_normal((len(t) + 1, 3)), axis=0)
    motion = Motion(t, None, None, None, q, dq, ddq + noise, tau_m=torque)
    held_out = HeldOut(equations, {"held out": [motion]})
    true = equations.base.T @ equations.nominal
    raw, judged = (
        [
            sum(held_out.errors(Psi, averages=averages)["held out"]["whole"].values())
            for Psi in (true, 0.5 * true)
        ]
        for averages in (False, True)
    )
    assert raw[0] > raw[1]
    assert judged[0] < 0.5 * judged[1]


@pytest.mark.parametrize("lost", ["samples", "channel"])
def test_a_held_out_recording_that_cannot_be_used_is_named_before_the_fit(
    lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind the fit, which may take minutes, the error would take its result along."""
    robot = load_robot(None)
    begun = []
    rng = np.random.default_rng(1)
    monkeypatch.setattr(Trials, "selected", lambda trials: begun.append(trials))
    fitted, short = (simulate(robot, trajectory(seed=3), duration=t, rng=rng) for t in (6.0, 0.03))
    held_out = short if lost == "samples" else replace(fitted, link=None)
    with pytest.raises(IdentificationError, match=r"^held out .*Record|^one recording contains"):
        identify(fitted, robot, validate=[replace(held_out, source="held out")])
    assert not begun
