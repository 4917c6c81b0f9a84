"""How held-out motion judges one arm against another."""

from __future__ import annotations

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification import identifier_of
from elastic_arm.identification.validation import HeldOut
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot, parse_urdf, to_urdf
from tests.helpers.periodic_arm import derivative, link_motion


def test_noise_in_accelerations_does_not_speak_for_small_masses() -> None:
    """With noise of 28 rad/s² half the masses miss less torque than the true ones; averages judge rightly."""
    arm, t, rng = parse_urdf(to_urdf(load_robot(None))), np.arange(4000) / 500.0, np.random.default_rng(3)
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
        [sum(by_side["whole"].values()) for Psi in (true, 0.5 * true) for by_side in of(Psi).values()]
        for of in (held_out.errors, held_out.judged)
    )
    assert raw[0] > raw[1]
    assert judged[0] < 0.5 * judged[1]
