"""The simulated arm against engines and integrators that know nothing of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.errors import EffectError, SimulationError
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.robot import Robot, load_robot, to_urdf
from elastic_arm.sensors import Encoder, Sensors, TorqueSensor
from elastic_arm.simulation import Controller, SimulationSettings, Simulator, simulate
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree

RATE = 1000.0


@pytest.fixture(scope="module")
def arm():
    return load_robot(None)


def swing(duration=10.0):
    """A Fourier motion of about half a radian that starts and stops at rest."""
    a, b = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 3, 3))
    return FourierTrajectory(2 * np.pi / 4.0, a, b, np.linspace(-0.3, 0.4, 3), duration, 0.4)


def reference(seconds):
    """Its first seconds."""
    return swing().evaluate(np.arange(round(seconds * RATE) + 1) / RATE)


def undamped(robot):
    joints = [replace(j, transmission=replace(j.transmission, damping=0.0)) for j in robot.joints]
    return robot.with_(joints=tuple(joints))


def springs(robot, x, dx):
    """K and D of drives and bearings, written out apart from the package: on the left side of (1),
    (dof,)."""
    n = robot.n
    f = np.zeros(len(x))
    for i, joint in enumerate(robot.joints):
        gear = joint.transmission
        torque = gear.stiffness * (x[i] - x[n + i]) + gear.damping * (dx[i] - dx[n + i])
        f[i] += torque
        f[n + i] -= torque
        for k in (2 * n + i, 3 * n + i) if len(x) > 2 * n else ():
            f[k] += gear.bearing.stiffness * x[k] + gear.bearing.damping * dx[k]
    return f


def integrate(rate, y, command):
    """DOP853 from sample to sample under held torques (N, n): y at every sample and the end."""
    course = [y]
    for held in command:
        solution = solve_ivp(
            lambda _, y, u=held: rate(y, u),
            (0.0, 1 / RATE),
            course[-1],
            "DOP853",
            rtol=1e-12,
            atol=1e-14,
            first_step=1 / RATE,
        )
        course.append(solution.y[:, -1])
    return np.array(course)


def test_error_over_ten_seconds_is_below_1e_minus_8_rad(arm):
    """Over 10 s under the same held torques the motion stays within 1e-8 rad of DOP853 at a
    tolerance of 1e-12."""
    truth, _ = Simulator(arm, SimulationSettings(sensors=Sensors.exact()), q0=swing().q0).follow(
        *reference(10.0)
    )
    function = build_model(arm).function("forward_dynamics")
    buffer, run = function.buffer()
    x = np.zeros(6)
    dx = np.zeros(6)
    f = np.zeros(6)
    ddx = np.zeros(6)
    psi = build_model(arm).Psi.copy()
    for k, array in enumerate((x, dx, f, psi)):
        buffer.set_arg(k, memoryview(array))
    buffer.set_res(0, memoryview(ddx))

    def rate(y, command):
        x[:] = y[:6]
        dx[:] = y[6:]
        f[3:] = command
        run()
        return np.concatenate([y[6:], ddx])

    exact = integrate(rate, np.concatenate([truth.x[0], truth.dx[0]]), truth.command[:-1])
    assert np.abs(exact[:, :6] - truth.x).max() < 1e-8
    assert np.ptp(truth.x, axis=0).min() > 0.5


@pytest.mark.parametrize("bearings", [False, True])
def test_motion_agrees_with_pinocchio(arm, bearings):
    """An arm of separate bodies in Pinocchio, reduced by its gears, moves alike under the same
    torques."""
    tree = KinematicTree(arm, bearings=bearings)
    simulator = Simulator(
        arm,
        SimulationSettings(bearings=bearings, sensors=Sensors.exact(), substeps=20),
        q0=swing().q0,
    )
    command = np.random.default_rng(0).normal(0, 60.0, (60, 3)) + simulator.state.command
    truth, _ = simulator.drive(command)
    dof = truth.x.shape[1]

    def rate(y, held):
        x = y[:dof]
        dx = y[dof:]
        mass, bias = tree.terms(x, dx)
        f = -bias - springs(arm, x, dx)
        f[3:6] += held
        return np.concatenate([dx, np.linalg.solve(mass, f)])

    exact = integrate(rate, np.concatenate([truth.x[0], truth.dx[0]]), command[:-1])
    assert np.abs(exact[:, :dof] - truth.x).max() < 1e-9
    assert np.abs(truth.x[-1] - truth.x[0]).max() > 1e-4


@pytest.mark.parametrize("bearings", [False, True])
def test_energy_is_conserved_without_damping_and_input(arm, bearings):
    """A falling undamped arm keeps its energy."""
    free = undamped(arm)
    if bearings:
        for joint in free.joints:
            gear = joint.transmission
            gear = replace(gear, bearing=replace(gear.bearing, damping=0.0))
            free = free.with_joint(joint.name, transmission=gear)
    simulator = Simulator(
        free,
        SimulationSettings(bearings=bearings, sensors=Sensors.exact(), substeps=40),
        q0=np.full(3, 0.5),
    )
    truth, _ = simulator.drive(np.zeros((1500, 3)))
    kinetic, potential = build_model(free, bearings=bearings).energy(truth.x, truth.dx)
    energy = kinetic + potential
    assert np.ptp(energy) < 1e-6 * np.ptp(potential)
    assert np.ptp(potential) > 100.0


def test_the_integrator_is_of_fourth_order(arm):
    """Half the step, a sixteenth of the error."""
    stiff_free = [
        Simulator(
            arm, SimulationSettings(sensors=Sensors.exact(), rate=100.0, substeps=s), q0=np.zeros(3)
        )
        .drive(np.full((60, 3), 80.0))[0]
        .x
        for s in (4, 8, 64)
    ]
    coarse, fine = (np.abs(x - stiff_free[2]).max() for x in stiff_free[:2])
    assert 12 < coarse / fine < 20


@pytest.mark.parametrize("engine", ["c", "casadi"])
def test_stepping_gives_the_bits_of_the_rollout(arm, engine):
    """One sample at a time or all at once: the same bits of truth and measurement, noise and delay
    included."""
    encoder = Encoder(noise=1e-5, velocity_noise=1e-4, delay=0.0013)
    sensors = Sensors(link_encoder=encoder, joint_torque=TorqueSensor(delay=0.002))
    effects = [
        parse("hysteresis:joint_2:torque=5,width=1e-4"),
        parse("coulomb_friction:joint_1:torque=8"),
    ]

    def make():
        rng = np.random.default_rng(3)
        return Simulator(
            arm,
            SimulationSettings(effects=effects, sensors=sensors, engine=engine),
            rng=rng,
            q0=swing().q0,
        )

    q, dq, ddq = reference(0.1)
    whole, measured = make().follow(q, dq, ddq)
    stepped = make()
    for k in range(len(q)):
        truth, seen = stepped.step((q[k], dq[k], ddq[k]))
        assert np.array_equal(truth.x[0], whole.x[k])
        assert np.array_equal(truth.tau_J[0], whole.tau_J[k])
        assert truth.t[0] == whole.t[k]
        assert all(np.array_equal(seen[name][0], measured[name][k]) for name in seen)


def test_engines_agree(arm):
    """The engine that needs no compiler gives the compiled one's motion."""
    effects = [
        parse("backlash:joint_2:half_gap=1e-4"),
        parse("transmission_error:joint_3:amplitude=2e-5"),
    ]
    c, machine = (
        Simulator(
            arm,
            SimulationSettings(effects=effects, sensors=Sensors.exact(), engine=engine),
            q0=swing().q0,
        ).follow(*reference(0.5))[0]
        for engine in ("c", "casadi")
    )
    assert np.abs(c.x - machine.x).max() < 1e-10
    assert np.abs(c.tau_J - machine.tau_J).max() < 1e-6


def test_without_a_compiler_the_simulation_works_and_says_that_it_is_slower(
    arm, monkeypatch, caplog
):
    """No compiler: another engine, and a warning with the remedy."""
    monkeypatch.setenv("CC", "")
    simulator = Simulator(arm, q0=np.zeros(3))
    assert simulator.integrator.name == "casadi"
    assert "slower" in caplog.text
    truth, _ = simulator.follow(*reference(0.02))
    assert np.isfinite(truth.x).all()


def test_kernels_are_compiled_once_per_structure(arm, monkeypatch, tmp_path):
    """Other inertias and other sizes of effects find the kernel of the first."""

    def rare(torque):
        """Effects that no other test combines, so that this process does not know them."""
        return [parse(f"coulomb_friction:joint_{k}:torque={torque},side=link") for k in (1, 3)]

    monkeypatch.setenv("ELASTIC_ARM_CACHE", str(tmp_path))
    Simulator(arm, SimulationSettings(effects=rare(3), engine="c"))
    made = sorted(tmp_path.glob("*.so"))
    assert made
    heavier = arm.with_joint(
        "joint_2", link=replace(arm.joints[1].link, mass=arm.joints[1].link.mass * 1.3)
    )
    Simulator(heavier, SimulationSettings(effects=rare(30), engine="c"))
    assert sorted(tmp_path.glob("*.so")) == made


@pytest.mark.parametrize("q0", [(0.0, -0.16, 0.5), (0.0, -0.14, 0.5)])
def test_an_arm_with_play_starts_at_the_loaded_end_of_it(arm, q0):
    """Where gravity's own slope points to the other end, too; a drive is wound by its load beyond
    the play."""
    half_gap = 1e-4
    simulator = Simulator(
        arm, SimulationSettings(effects=[parse(f"backlash:joint_2:half_gap={half_gap}")]), q0=q0
    )
    plain = Simulator(arm, SimulationSettings(), q0=q0)
    found, expected = (one.state.y[3:6] - one.state.y[:3] for one in (simulator, plain))
    assert 1e-6 < np.abs(expected[1]) < half_gap
    play = np.array([0.0, half_gap * np.sign(expected[1]), 0.0])
    np.testing.assert_allclose(found, expected + play, atol=1e-6)


def test_a_drive_that_softens_starts_below_its_fold_or_not_at_all(arm):
    """K d + c d³ falls beyond the square root of K / 3 |c|, where no arm stays; too soft, it holds
    no load at all."""
    q0 = (0.0, 0.3, 0.5)
    deflections = []
    for text in ((), (parse("nonlinear_stiffness:joint_2:cubic=-3e9"),)):
        state = Simulator(arm, SimulationSettings(effects=list(text)), q0=q0).state.y
        deflections.append(state[4] - state[1])
    assert deflections[1] == pytest.approx(deflections[0], rel=0.1)
    with pytest.raises(SimulationError, match="no static equilibrium"):
        Simulator(
            arm,
            SimulationSettings(effects=[parse("nonlinear_stiffness:joint_2:cubic=-1e10")]),
            q0=q0,
        )


@pytest.mark.parametrize("bearings", [False, True])
def test_the_arm_starts_in_equilibrium(arm, bearings):
    """Held by the torque of its start, the arm hangs in its drives and does not move."""
    q0 = np.array([0.3, -0.4, 0.5])
    simulator = Simulator(
        arm, SimulationSettings(bearings=bearings, sensors=Sensors.exact()), q0=q0
    )
    truth, _ = simulator.drive(np.tile(simulator.state.command, (200, 1)))
    assert np.abs(truth.x - truth.x[0]).max() < 1e-10
    assert np.abs(truth.q[0] - q0).max() > 1e-4
    gravity = build_model(arm).terms(truth.x[:1, :6], np.zeros((1, 6)))["g"]
    assert np.abs(truth.tau_J[0] - gravity[0]).max() < (0.2 if bearings else 1e-9)


def test_a_torque_sample_is_the_mean_over_its_interval(arm):
    """tau_m is the mean of the two commands it bounds, tau_J the mean of the torque over the
    interval around it."""
    truth, _ = Simulator(arm, SimulationSettings(sensors=Sensors.exact()), q0=swing().q0).follow(
        *reference(0.6)
    )
    assert np.array_equal(truth.tau_m[1:], 0.5 * (truth.command[1:] + truth.command[:-1]))
    fine = Simulator(
        arm, SimulationSettings(sensors=Sensors.exact(), rate=100 * RATE, substeps=2), q0=swing().q0
    )
    dense, _ = fine.drive(np.repeat(truth.command, 100, axis=0))
    gears = [j.transmission for j in arm.joints]
    K, D = (np.array([getattr(g, name) for g in gears]) for name in ("stiffness", "damping"))
    torque = K * (dense.theta - dense.q) + D * (dense.dtheta - dense.dq)
    for k in (1, 50, 500):
        part = torque[100 * k - 50 : 100 * k + 51]
        mean = (part[:-1] + part[1:]).mean(axis=0) / 2
        assert np.abs(mean - truth.tau_J[k]).max() < 1e-4


def test_seeds_reproduce(arm):
    """The same seed gives the same recording, another one another."""
    one, same, other = (
        simulate(arm, swing(), duration=0.1, rng=np.random.default_rng(seed)).samples()
        for seed in (1, 1, 2)
    )
    assert np.array_equal(one.tau_J, same.tau_J)
    assert not np.array_equal(one.tau_J, other.tau_J)
    assert np.array_equal(one.q, other.q)


def test_commands_stay_within_the_torque_limits(arm):
    """A controller that wants more gets the limit."""
    limited = arm.with_joint("joint_2", limits=replace(arm.joints[1].limits, torque=150.0))
    truth, _ = Simulator(limited, q0=swing().q0).follow(*reference(1.0))
    assert np.abs(truth.command[:, 1]).max() == 150.0


@pytest.mark.parametrize("rate", [250.0, 1000.0])
@pytest.mark.parametrize("ratio", [5, 128, 363])
def test_the_tuned_controller_is_stable_at_every_ratio_and_rate(arm, ratio, rate):
    """Light motors and slow loops bound the gains: the arm follows, and a push dies out."""
    robot = arm.with_ratio(ratio)
    still = np.tile(swing().q0, (round(4 * rate), 1))
    simulator = Simulator(
        robot,
        SimulationSettings(sensors=Sensors.exact(), rate=rate, substeps=int(10000 / rate)),
        q0=still[0],
    )
    simulator.state.y[6:12] += 0.05
    truth, _ = simulator.follow(still, 0 * still, 0 * still)
    excursion = np.abs(truth.theta - truth.theta[-1])
    assert excursion[-len(still) // 8 :].max() < 0.1 * excursion.max()
    assert excursion.max() < 0.1


def test_a_recording_knows_only_the_nominal_arm(arm):
    """Whatever the true arm is, the recording's description is the nominal one, and no effect is
    named in it."""
    heavier = arm.with_joint("joint_3", link=replace(arm.joints[2].link, mass=30.0)).with_(
        name="the_truth"
    )
    effects = [parse("coulomb_friction:joint_2:torque=13.9")]
    recording = simulate(
        heavier, swing(), SimulationSettings(nominal=arm, effects=effects), duration=0.05
    )
    assert recording.robot_description == to_urdf(arm)
    assert "coulomb" not in repr(recording) and "the_truth" not in repr(recording)
    assert len(recording.link) == len(recording.motor) == len(recording.reference) == 51
    assert recording.joints == arm.joint_names


def test_effects_of_the_arm_file_act(arm):
    """An arm whose description lists an effect has it."""
    listed = arm.with_(effects=(parse("viscous_friction:joint_1:coefficient=30").to_dict(),))
    given = [parse("viscous_friction:joint_1:coefficient=30")]
    one = Simulator(listed, SimulationSettings(nominal=arm), q0=swing().q0).follow(*reference(0.3))[
        0
    ]
    two = Simulator(arm, SimulationSettings(effects=given), q0=swing().q0).follow(*reference(0.3))[
        0
    ]
    assert np.array_equal(one.x, two.x)


def test_effects_change_while_the_arm_moves(arm):
    """Effects switched on in mid-motion act from the state the arm is in."""
    q, dq, ddq = reference(0.6)
    simulator = Simulator(arm, SimulationSettings(sensors=Sensors.exact()), q0=swing().q0)
    simulator.follow(q[:300], dq[:300], ddq[:300])
    before = simulator.state.y.copy()
    simulator.change_effects(
        [parse("hysteresis:joint_2:torque=5,width=1e-4"), parse("bearing_compliance")]
    )
    truth, _ = simulator.follow(q[300:], dq[300:], ddq[300:])
    assert np.array_equal(truth.x[0, :6], before[:6]) and np.array_equal(
        truth.dx[0, :6], before[6:12]
    )
    assert truth.t[0] == 0.3
    assert np.abs(truth.theta - q[300:]).max() < 1e-3


def test_effects_that_cannot_be_taken_leave_the_arm_as_it_was(arm):
    """A payload that no drive can hold is refused, and the arm goes on, to the bit, as if nobody
    had asked."""
    still = (np.zeros((50, 3)),) * 3

    def run(ask: bool):
        simulator = Simulator(
            arm, SimulationSettings(effects=[parse("viscous_friction:joint_1:coefficient=30")])
        )
        simulator.follow(*still)
        if ask:
            with pytest.raises(SimulationError, match="no static equilibrium"):
                simulator.change_effects([parse("payload:mass=1e6")])
        return simulator.effects, simulator.follow(*still)[0]

    (asked, one) = run(True)
    (alone, two) = run(False)
    assert asked == alone
    assert np.array_equal(one.x, two.x)


def test_a_prediction_starts_from_any_motion(arm):
    """Placed into a motion of another run and given its torques, the arm goes on as that run
    did."""
    effects = [parse("hysteresis:joint_2:torque=5,width=1e-4")]
    truth, _ = Simulator(
        arm, SimulationSettings(effects=effects, sensors=Sensors.exact()), q0=swing().q0
    ).follow(*reference(0.8))
    k = 500
    other = Simulator(arm, SimulationSettings(effects=effects, sensors=Sensors.exact()))
    other.place(
        truth.q[k],
        truth.theta[k],
        truth.dq[k],
        truth.dtheta[k],
        command=truth.command[k - 1],
        z=truth.z[k],
    )
    ahead, _ = other.drive(truth.command[k : k + 200])
    assert np.array_equal(ahead.x, truth.x[k : k + 200])
    assert np.array_equal(ahead.tau_m, truth.tau_m[k : k + 200])


def test_a_motion_that_explodes_is_named(arm):
    """An unstable loop ends in an error with time, joint and remedy."""
    wild = Controller(np.full(3, 1e12), np.zeros(3))
    with pytest.raises(SimulationError, match=r"[0-9.]+ s .*joint_[123].*gains"):
        Simulator(arm, SimulationSettings(controller=wild), q0=swing().q0).follow(*reference(1.0))


@pytest.mark.parametrize(
    ("settings", "start", "word"),
    [
        ({"substeps": 3}, {}, "even"),
        ({"rate": 0.0}, {}, "rate"),
        ({}, {"q0": np.zeros(2)}, "start"),
        ({"model": "mod4"}, {}, "mod4"),
    ],
)
def test_settings_without_sense_are_refused(arm, settings, start, word):
    """The error names what is wrong."""
    with pytest.raises(ValueError if "model" in settings else SimulationError, match=word):
        Simulator(arm, SimulationSettings(**settings), **start)


def test_any_number_of_joints_moves():
    """Seven joints, without transmissions: falls as Pinocchio says."""
    import pinocchio as pin

    three = load_robot(None)
    rigid = Robot("rigid", tuple(replace(j, transmission=None) for j in three.joints))
    joints = [
        replace(rigid.joints[k % 3], name=f"joint_{k + 1}", link_name=f"link_{k + 1}")
        for k in range(7)
    ]
    robot = rigid.with_(joints=tuple(joints))
    model = pin.Model()
    model.gravity = pin.Motion(robot.gravity, np.zeros(3))
    parent = 0
    placement = pin.SE3.Identity()
    for joint in robot.joints:
        before, after = (
            pin.SE3(m[:3, :3].copy(), m[:3, 3].copy()) for m in (joint.before, joint.after)
        )
        parent = model.addJoint(parent, pin.JointModelRZ(), placement * before, joint.name)
        inertia = pin.Inertia(joint.link.mass, joint.link.com.copy(), joint.link.inertia.copy())
        model.appendBodyToJoint(parent, inertia, after)
        placement = after
    data = model.createData()
    command = np.random.default_rng(0).normal(0, 30.0, (40, 7))
    truth, _ = Simulator(robot, SimulationSettings(sensors=Sensors.exact(), substeps=20)).drive(
        command
    )

    def rate(y, held):
        return np.concatenate([y[7:], pin.aba(model, data, y[:7], y[7:], held)])

    exact = integrate(rate, np.zeros(14), command[:-1])
    assert np.abs(exact[:, :7] - truth.q).max() < 1e-9
    with pytest.raises(EffectError, match="transmission"):
        Simulator(robot, SimulationSettings(effects=[parse("backlash:joint_2:half_gap=1e-4")]))
