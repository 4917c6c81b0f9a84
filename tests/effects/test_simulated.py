"""Effects forward in time: against an engine that shares no code with the catalogue, and by the
energy they keep."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Sensors
from elastic_arm.simulation import SimulationSettings, Simulator
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import KNOWN, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import SENSOR_EFFECTS as READ_WRONG
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import needs_further_laws
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from tests.helpers.effect_samples import INSTANCES, contribution, law_function, random_motion

RATE = 1000.0
SENSOR_EFFECTS = {
    "motor_torque_gain",
    "joint_torque_gain",
    "motor_torque_offset",
    "joint_torque_offset",
    "encoder_offset",
    "encoder_eccentricity",
    "time_delay",
    "torque_drift",
    "torque_lowpass",
}
SCALES = {"thermal_friction", "asymmetric_friction"}  # nothing by itself
IN_EQUATIONS = sorted(set(INSTANCES) - SENSOR_EFFECTS - SCALES)


@pytest.fixture(scope="module")
def arm():
    return load_robot(None)


def reference(seconds, rate=1.0, size=0.4, offset=(0.0, 0.4, 0.5)):
    """All joints swing at `rate` Hz and half of it, from rest."""
    t = np.arange(round(seconds * RATE) + 1)[:, None] / RATE
    w = 2 * np.pi * rate * np.array([1.0, 0.5, 0.75])
    return (
        offset + size * (1 - np.cos(w * t)),
        size * w * np.sin(w * t),
        size * w**2 * np.cos(w * t),
    )


def run(robot, effects=(), seconds=1.0, **settings):
    q, dq, ddq = reference(seconds)
    start = {"q0": q[0]} | {
        name: settings.pop(name) for name in ("q0", "dq0", "duration") if name in settings
    }
    settings = {"sensors": Sensors.exact(), "nominal": robot, "effects": effects} | settings
    return Simulator(robot, SimulationSettings(**settings), **start).follow(q, dq, ddq)


def fault(instance, robot):
    """The same effect in the words of the hidden arm."""
    numbers = {p.name: instance.parameters[p.name] for p in instance.effect.parameters}
    if "position" in numbers:
        numbers |= {
            f"position_{axis}": v for axis, v in zip("xyz", numbers.pop("position"), strict=True)
        }
    joint = None if instance.joint is None else robot.joint_names.index(instance.joint)
    return Fault(instance.effect.id, joint, numbers, instance.parameters.get("side", "motor"))


@pytest.mark.parametrize(
    "effect",
    sorted((set(IN_EQUATIONS) & KNOWN) - READ_WRONG - {"spline_inertia", "inertia_coupling"}),
)
def test_accelerations_agree_with_the_hidden_arm(arm, effect):
    """An arm in Pinocchio with effects written apart from the catalogue accelerates alike at random
    states."""
    text = INSTANCES[effect][0].split(",com=")[0]  # the hidden arm's links change in proportion
    instance = parse(text, arm)
    faults = [fault(instance, arm)]
    hidden = HiddenArm(arm, faults, standstill=1e-4)
    # and the states of further laws before it
    clock = np.zeros(arm.n + 1 if needs_further_laws(faults) else 0)
    simulator = Simulator(arm, SimulationSettings(effects=[instance], sensors=Sensors.exact()))
    constants = simulator.system.evaluate_constants(np.full(6, 1e-4))
    dof = simulator.system.dof
    rng = np.random.default_rng(0)
    for _ in range(5):
        motion = random_motion(arm, rng)
        tilts = rng.uniform(-1e-4, 1e-4, (2, dof - 6))
        x, dx = (
            np.append(motion[name], tilt) for name, tilt in zip(("x", "dx"), tilts, strict=True)
        )
        z = rng.uniform(-1, 1, simulator.system.states)
        ddx, dz, _ = (
            np.array(v).ravel()
            for v in simulator.system.accelerations(x, dx, z, motion["tau_m"], constants)
        )
        state = np.concatenate([x, dx, [0.0, *z, 0.0] if len(z) else np.zeros(3), clock])
        expected = hidden.rate(state, motion["tau_m"])
        assert np.allclose(ddx, expected[dof : 2 * dof], rtol=1e-9, atol=1e-8)
        assert np.allclose(dz, expected[2 * dof + 1 : 2 * dof + 2] if len(z) else [], rtol=1e-12)


@pytest.mark.parametrize("effect", sorted(set(IN_EQUATIONS) - {"bearing_compliance"}))
def test_residuals_of_a_simulated_arm_are_the_law(arm, effect):
    """The nominal model misses a simulated arm by exactly what the law says, in all three equations
    of every joint."""
    text, name = INSTANCES[effect]
    instance = parse(text, arm)
    model = build_model(arm, name, engine="numpy")
    simulator = Simulator(
        arm, SimulationSettings(model=name, effects=[instance], sensors=Sensors.exact())
    )
    system = simulator.system
    constants = simulator._loop.constants
    K, D = (
        np.array([getattr(j.transmission, k) for j in arm.joints]) for k in ("stiffness", "damping")
    )
    rng = np.random.default_rng(0)
    largest = 0.0
    for _ in range(3):
        motion = random_motion(arm, rng)
        x = motion["x"]
        dx = motion["dx"]
        u = motion["tau_m"]
        z = rng.uniform(-1, 1, system.states)
        motion["ddx"], _, motion["tau_J"] = (
            np.array(v).ravel() for v in system.accelerations(x, dx, z, u, constants)
        )
        drive = K * (x[3:] - x[:3]) + D * (dx[3:] - dx[:3])
        left = model.inverse_dynamics(x[None], dx[None], motion["ddx"][None])[0]
        law = contribution(arm, [instance], motion, z, name)
        assert np.allclose(motion["tau_J"] - (left[:3] + drive), law["link"], atol=1e-8)
        assert np.allclose(motion["tau_J"] - drive, law["drive"], atol=1e-8)
        assert np.allclose(u - (left[3:] - drive) - motion["tau_J"], law["motor"], atol=1e-8)
        largest = max(largest, *(np.abs(law[side]).max() for side in ("link", "drive", "motor")))
    assert largest > 1e-3


def test_friction_of_a_simulated_arm_changes_over_the_run(arm):
    """Half a turn to and half a turn fro at one speed: what the motor needs beside the load falls
    from begin to end."""
    t = np.arange(4001)[:, None] / RATE
    speed = 0.5 * np.where(t % 2.0 < 1.0, 1.0, -1.0) * [[1.0, 0.0, 0.0]]
    q = np.cumsum(speed, axis=0) / RATE
    still = np.zeros_like(speed)
    friction = [
        parse("coulomb_friction:joint_1:torque=20", arm),
        parse("viscous_friction:joint_1:coefficient=10", arm),
    ]
    warm = parse("thermal_friction:joint_1:change=-0.4", arm)
    torques = []
    for effects in (friction, [*friction, warm]):
        simulator = Simulator(
            arm,
            SimulationSettings(effects=effects, sensors=Sensors.exact(), nominal=arm),
            dq0=speed[0],
            duration=4.0,
        )
        truth, _ = simulator.follow(q, speed, still)
        torques.append(truth.tau_m[:, 0] - truth.tau_J[:, 0])
    for k in (700, 1700, 2700, 3700):
        assert torques[1][k] / torques[0][k] == pytest.approx(1 - 0.4 * (k / 4000 - 0.5), abs=0.01)


@pytest.mark.parametrize(
    "effect", sorted(SENSOR_EFFECTS - {"time_delay", "torque_drift", "torque_lowpass"})
)
def test_residuals_of_recorded_channels_are_the_law(arm, effect):
    """What a sensor effect changes in the channels changes the residuals of the nominal model as
    its law says."""
    instance = parse(INSTANCES[effect][0], arm)
    truth, measured = run(arm, [instance], seconds=0.3)
    K, D = (
        np.array([getattr(j.transmission, k) for j in arm.joints]) for k in ("stiffness", "damping")
    )

    def residuals(c):
        drive = c["tau_J"] - K * (c["theta"] - c["q"]) - D * (c["dtheta"] - c["dq"])
        return {"link": c["tau_J"], "drive": drive, "motor": c["tau_m"] - c["tau_J"]}

    before = residuals(truth.channels())
    after = residuals(measured)
    for k in (10, 150, 290):
        motion = {"x": np.append(measured["q"][k], measured["theta"][k]), "ddx": np.zeros(6)}
        motion["dx"] = np.append(measured["dq"][k], measured["dtheta"][k])
        motion |= {"tau_J": measured["tau_J"][k], "tau_m": measured["tau_m"][k]}
        motion |= {"dtau_J": np.zeros(3), "dtau_m": np.zeros(3)}
        motion = {
            name: motion[name] for name in ("x", "dx", "ddx", "tau_J", "tau_m", "dtau_J", "dtau_m")
        }
        law = contribution(arm, [instance], motion)
        for side in ("link", "drive", "motor"):
            size = np.abs(law[side]).max()
            assert (
                np.abs(after[side][k] - before[side][k] - law[side]).max() <= 1e-3 * size + 1e-9
            ), side


@pytest.mark.parametrize("channel", ["joint_torque", "motor_torque", "link_encoder"])
def test_time_delay_makes_its_channels_late(arm, channel):
    """A delayed channel holds what was true two milliseconds before; the others are untouched."""
    truth, measured = run(arm, [parse(f"time_delay:joint_2:delay=0.002,channels={channel}")])
    late = {"joint_torque": ("tau_J",), "motor_torque": ("tau_m",), "link_encoder": ("q", "dq")}[
        channel
    ]
    for name, true in truth.channels().items():
        expected = true.copy()
        if name in late:
            expected[2:, 1] = true[:-2, 1]
            expected[:2, 1] = true[0, 1]
        assert np.array_equal(measured[name], expected)


@pytest.mark.parametrize("channel", ["joint_torque", "motor_torque"])
def test_torque_drift_moves_the_zero_of_its_channel(arm, channel):
    """The recorded torque is the true one and the rate times the time since the first sample."""
    truth, measured = run(arm, [parse(f"torque_drift:joint_2:rate=0.2,channel={channel}")])
    name = {"joint_torque": "tau_J", "motor_torque": "tau_m"}[channel]
    for other, true in truth.channels().items():
        expected = true.copy()
        if other == name:
            expected[:, 1] += 0.2 * np.arange(len(true)) / RATE
        assert np.allclose(measured[other], expected, atol=1e-9)


def test_torque_lowpass_is_the_law(arm):
    """Recorded less true torque is -T times the rate of the recorded torque, T = 1 / (2 pi
    cutoff)."""
    truth, measured = run(
        arm, [parse("torque_lowpass:joint_2:cutoff=5,channels=joint_torque+motor_torque")]
    )
    for name in ("tau_J", "tau_m"):
        y = measured[name][:, 1]
        true = truth.channels()[name][:, 1]
        rate = np.diff(y) * RATE
        expected = -0.5 * (rate[1:] + rate[:-1]) / (2 * np.pi * 5)
        # At the first samples the load comes at once.
        late = (y - true)[100:-1]
        assert np.abs(late - expected[99:]).max() < 0.02 * np.abs(late).max()
        assert np.abs(late).max() > 0.1
    assert np.array_equal(measured["q"], truth.channels()["q"])


def free(robot):
    """The arm without damping."""
    joints = [replace(j, transmission=replace(j.transmission, damping=0.0)) for j in robot.joints]
    return robot.with_(joints=tuple(joints))


def stored(effect, p, gear, theta, q):
    """Energy in the second joint's drive, and that of the motor's ripple."""
    d = theta - q
    if effect == "transmission_error":
        d = d + p["amplitude"] * np.sin(p["order"] * gear.harmonic_drive_ratio * theta + p["phase"])
    if effect == "backlash":
        d = np.maximum(np.abs(d) - p["half_gap"], 0.0)
    energy = 0.5 * gear.stiffness * d**2
    if effect == "nonlinear_stiffness":
        energy = energy + p["cubic"] * d**4 / 4
    if effect == "torque_ripple":
        spatial = p["order"] * gear.r_tot
        energy = energy + p["amplitude"] / spatial * np.cos(spatial * theta + p["phase"])
    return energy


@pytest.mark.parametrize(
    "effect", ["nonlinear_stiffness", "backlash", "transmission_error", "torque_ripple"]
)
def test_conservative_effects_keep_energy(arm, effect):
    """By virtual work, an undamped falling arm with this effect keeps its energy, the effect's own
    part counted."""
    robot = free(arm)
    name, _, values = INSTANCES[effect][0].split(":")
    instance = parse(f"{name}:joint_2:{values}")
    simulator = Simulator(
        robot,
        SimulationSettings(effects=[instance], sensors=Sensors.exact(), substeps=40),
        q0=np.full(3, 0.5),
    )
    truth, _ = simulator.drive(np.zeros((1000, 3)))
    kinetic, potential = build_model(robot, engine="numpy").energy(truth.x, truth.dx)
    gear = robot.joints[1].transmission
    theta = truth.theta[:, 1]
    q = truth.q[:, 1]
    energy = kinetic + potential - 0.5 * gear.stiffness * (theta - q) ** 2
    energy = energy + stored(effect, instance.parameters, gear, theta, q)
    without = kinetic + potential
    assert np.ptp(energy) < 2e-3 * np.ptp(without) or np.ptp(energy) < 1e-5 * np.ptp(kinetic)
    assert np.ptp(without) > 20 * np.ptp(energy)


def test_dry_friction_holds_a_joint_nearly_still(arm):
    """A torque below Coulomb's leaves the vertical axis creeping below the regularisation speed;
    one above moves it."""
    simulator = Simulator(
        arm,
        SimulationSettings(
            effects=[parse("coulomb_friction:joint_1:torque=20")], sensors=Sensors.exact()
        ),
    )
    push = np.array([10.0, 0.0, 0.0])
    held, _ = simulator.drive(np.tile(simulator.state.command + push, (500, 1)))
    assert np.abs(held.dtheta[:, 0]).max() < simulator.sign_speed[3]
    moved, _ = simulator.drive(np.tile(held.command[-1] + 2 * push, (500, 1)))
    assert moved.dtheta[-1, 0] > 100 * simulator.sign_speed[3]


def test_friction_that_outruns_the_integrator_is_widened(arm):
    """At a low ratio the motor is light: the regularisation widens until friction is stable, and
    stays stable."""
    light = arm.with_ratio(5)
    simulator = Simulator(
        light,
        SimulationSettings(
            effects=[parse("coulomb_friction:joint_1:torque=20")], sensors=Sensors.exact()
        ),
    )
    assert simulator.sign_speed[3] > 1e-3 and simulator.sign_speed[4] == 1e-4
    push = np.array([10.0, 0.0, 0.0])
    truth, _ = simulator.drive(np.tile(simulator.state.command + push, (300, 1)))
    assert np.abs(np.diff(truth.dtheta[-50:, 0])).max() < 1e-6


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("stiffness_mismatch:joint_2:stiffness=0.85", {"stiffness": 90000.0 * 0.85}),
        ("damping_mismatch:joint_2:damping=1.5", {"damping": 120.0}),
    ],
)
def test_mismatches_move_as_the_changed_arm(arm, text, change):
    """A mismatch in the catalogue and the same number changed in the arm file give one motion."""
    gear = replace(arm.joints[1].transmission, **change)
    one, _ = run(arm, [parse(text)])
    two, _ = run(arm.with_joint("joint_2", transmission=gear), nominal=arm)
    assert np.abs(one.x - two.x).max() < 1e-10


def test_model_form_effects_make_the_richer_model(arm):
    """mod1 with the spline's inertia moves as mod2, mod2 with S as mod3, mod1 with both as mod3."""
    nominal = {"controller": Simulator(arm).controller}
    mod1, mod2, mod3 = (run(arm, model=name, **nominal)[0].x for name in ("mod1", "mod2", "mod3"))
    spline = parse("spline_inertia")
    coupling = parse("inertia_coupling")
    assert np.abs(run(arm, [spline], model="mod1", **nominal)[0].x - mod2).max() < 1e-10
    assert np.abs(run(arm, [coupling], model="mod2", **nominal)[0].x - mod3).max() < 1e-10
    assert np.abs(run(arm, [spline, coupling], model="mod1", **nominal)[0].x - mod3).max() < 1e-10
    assert np.abs(mod1 - mod2).max() > 1e-8 and np.abs(mod2 - mod3).max() > 1e-8


def test_bearing_compliance_frees_the_tilts(arm):
    """With the arm file's bearings the effect is the arm of twelve coordinates."""
    one, _ = run(arm, [parse("bearing_compliance")])
    two, _ = run(arm, bearings=True)
    assert one.x.shape[1] == 12 and np.array_equal(one.x, two.x)
    assert np.abs(one.x[:, 6:]).max() > 1e-6


def test_a_tilted_base_loads_the_vertical_axis(arm):
    """At rest a tilt shows on the first joint, which gravity otherwise cannot reach."""
    q0 = np.array([0.5, 0.5, 0.5])
    level = Simulator(arm, SimulationSettings(sensors=Sensors.exact()), q0=q0).state.command
    tilted = Simulator(
        arm, SimulationSettings(effects=[parse("base_tilt:x=0.02")], sensors=Sensors.exact()), q0=q0
    ).state.command
    assert abs(level[0]) < 1e-9 and abs(tilted[0]) > 1.0


def smoothed(y):
    """Zero-phase low pass at about 40 Hz."""
    return gaussian_filter1d(y, 4.0, axis=0)


def test_the_law_of_bearings_explains_a_simulated_arm(arm):
    """The law holds nine tenths of the power that the rigid model misses of an arm with bearings
    ten times softer."""
    instance = parse("bearing_compliance:stiffness_scale=0.1")
    a, b = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 3, 3))
    smooth = FourierTrajectory(2 * np.pi / 4.0, a, b, np.array([0.0, 0.4, 0.5]), 6.0, 1.0)
    q, dq, ddq = smooth.evaluate(np.arange(6001) / RATE)
    simulator = Simulator(
        arm, SimulationSettings(effects=[instance], sensors=Sensors.exact()), q0=q[0]
    )
    truth, _ = simulator.follow(q, dq, ddq)
    system = simulator.system
    constants = simulator._loop.constants
    rows = zip(truth.x, truth.dx, truth.command, strict=True)
    ddx = np.array(
        [np.array(system.accelerations(x, dx, [], u, constants)[0])[:6, 0] for x, dx, u in rows]
    )
    x = truth.x[:, :6]
    dx = truth.dx[:, :6]
    missed = -build_model(arm, engine="numpy").inverse_dynamics(x, dx, ddx)[:, :3]
    jerk = np.gradient(smoothed(ddx), 1 / RATE, axis=0)
    snap = np.gradient(jerk, 1 / RATE, axis=0)
    none = np.zeros((3, len(x)))
    channels = (x.T, dx.T, ddx.T, *[none] * 4, jerk.T, snap.T, none[:0])
    law = np.array(law_function(arm, [instance]).map(len(x))(*channels)[0]).T
    settled = slice(300, -100)
    left = smoothed(missed - law)[settled]
    whole = smoothed(missed)[settled]
    assert (left**2).sum() < 0.1 * (whole**2).sum()
    assert whole.std() > 0.05
