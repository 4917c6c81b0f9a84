"""The cases by which `mujoco.sysid` tests itself, run through `identify`: models, commands and
tolerances are its own.

MuJoCo's Runge–Kutta integrator moves the arms, so that the recording is that of the model and not
of its time steps; `mujoco.sysid` fits simulations of the same time steps.
"""

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.identification import identify
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot

mujoco = pytest.importorskip("mujoco")
cases = pytest.importorskip("mujoco.sysid.tests.test_integration")

TOLERANCE = 1e-4  # of mujoco.sysid's own tests
RATE = 500.0


def recorded(text: str, command: np.ndarray) -> Recording:
    """Return the recording of a model at rest that motor torques (N, n) set in motion."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.integrator, substeps = mujoco.mjtIntegrator.mjINT_RK4, 4
    model.opt.timestep = 1.0 / RATE / substeps
    data = mujoco.MjData(model)
    q, dq = np.empty((2, len(command) // substeps, model.nv))
    for k in range(len(q) * substeps):
        if k % substeps == 0:
            q[k // substeps], dq[k // substeps] = data.qpos, data.qvel
        data.ctrl[:] = command[k]
        mujoco.mj_step(model, data)
    stamp_ns = np.round(np.arange(len(q)) / RATE * 1e9).astype(np.int64)
    # A torque sample is the mean over the sample interval centred on its stamp.
    held = np.concatenate([command[:1].repeat(substeps // 2, axis=0), command])
    effort = held[: len(q) * substeps].reshape(len(q), substeps, -1).mean(axis=1)
    names = tuple(model.joint(k).name for k in range(model.njnt))
    return Recording(names, motor=Side(stamp_ns, q, dq, effort))


def time(duration: float) -> np.ndarray:
    """Return the times of the commands, s."""
    return np.arange(0.0, duration, 1.0 / RATE / 4)


def test_the_mass_on_a_spring(tmp_path: Path) -> None:
    """A mass of 1 kg between a spring and a damper is found from 2 kg."""
    t = time(3.0)
    command = 5.0 * np.sin(2 * np.pi * 1.5 * t) + 3.0 * np.sin(2 * np.pi * 3.7 * t)
    start = tmp_path / "start.xml"
    start.write_text(cases.SPRING_MASS_XML.replace('mass="1.0"', 'mass="2.0"'))
    result = identify(recorded(cases.SPRING_MASS_XML, command[:, None]), load_robot(start))
    (mass,) = [e.value for e in result.estimates if e.unit == "kg"]
    assert mass == pytest.approx(1.0, abs=TOLERANCE)
    assert result.identified.joints[0].link.mass == pytest.approx(1.0, abs=TOLERANCE)


def test_the_armatures_of_five_joints(tmp_path: Path) -> None:
    """Armatures of 0.1 to 0.5 kg m² are found from 0.01, beside inertias that `mujoco.sysid` is
    given.

    Those of the first two joints come as sums with link inertias, from which no motion can tell
    them.
    """
    t = time(2.0)
    parts = ((5.0, 0.5, 0.0), (4.0, 0.7, 0.5), (3.0, 0.4, 1.0), (2.0, 0.9, 1.5), (1.0, 0.6, 2.0))
    command = np.stack(
        [size * np.sin(2 * np.pi * f * t + phase) for size, f, phase in parts], axis=1
    )
    start, true, text = tmp_path / "start.xml", tmp_path / "true.xml", cases.ARM_XML
    true.write_text(text)
    for value in cases.TRUE_ARMATURE.values():
        text = text.replace(f'armature="{value}"', 'armature="0.01"')
    start.write_text(text)
    result = identify(recorded(cases.ARM_XML, command), load_robot(start))
    nominal = {p.name: p.nominal for p in build_model(load_robot(true)).bodies.parameters}
    sums = result.T @ np.array([nominal.get(name, 0.0) for name in result.parameter_names])
    found = {
        e.name: (e.value, e.verdict, value) for e, value in zip(result.estimates, sums, strict=True)
    }
    for joint in cases.JOINT_NAMES:
        ((value, verdict, expected),) = [
            sum_ for name, sum_ in found.items() if f"{joint}.armature" in name
        ]
        assert value == pytest.approx(expected, abs=TOLERANCE)
        assert verdict == "well"
    alone = {joint.name: joint.armature for joint in result.identified.joints[2:]}
    assert alone == pytest.approx(
        {joint: cases.TRUE_ARMATURE[joint] for joint in alone}, abs=TOLERANCE
    )
