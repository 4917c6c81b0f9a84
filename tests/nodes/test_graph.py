"""The nodes as processes on a real DDS graph."""

import json
import signal
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from elastic_arm_msgs.msg import JointTorques, ParameterEstimate
from rcl_interfaces.msg import Parameter as RosParameter
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from elastic_arm.identification import Identification, identifier_of
from elastic_arm.nodes.support.graph import qos
from elastic_arm.recording import read_recording
from elastic_arm.robot import load_robot
from examples.known_arm import chi_square
from tests.helpers.motions import lively_excitation
from tests.helpers.ros_graph import Graph, NodeProcess, ros_graph

pytestmark = pytest.mark.graph

JOINTS = ("joint_1", "joint_2", "joint_3")
STEP_NS = 1_000_000


def stamps(messages: list) -> np.ndarray:
    """Return the stamps of messages in ns."""
    return np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages])


class Run(NamedTuple):
    """What a whole run left behind."""

    generator: NodeProcess
    codes: dict[str, int]
    estimates: list[ParameterEstimate]
    bag: Path
    online: Path
    outputs: str


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An arm that is moved, recorded and identified, all at once, and then stopped by Ctrl-C."""
    folder = tmp_path_factory.mktemp("run")
    with ros_graph(folder) as graph:
        estimates = graph.listen(ParameterEstimate, "/parameter_estimate")
        identifier = graph.start("identifier", save_to=folder / "online", save_at_exit=True)
        recorder = graph.start("recorder", bag=folder / "bag")
        # Slower than real time, on its own clock: a machine that is busy with other work skips
        # nothing.
        simulator = graph.start("simulator", seed=4, real_time_factor=0.8)
        # Long beside what the first estimate is made of, so that deviations, which are estimates
        # too, have to shrink.
        generator = graph.start(
            "trajectory_generator", trajectory=lively_excitation(folder, 10.0), use_sim_time=True
        )
        graph.until(
            lambda: generator.process.poll() is not None, "the trajectory ends", patience=90
        )
        # The arm first, so that both listeners hear its last sample.
        codes = {node.name: node.stop() for node in (simulator, recorder, identifier)}
        outputs = "".join(node.output for node in graph.nodes)
        return Run(
            generator,
            codes,
            estimates,
            folder / "bag",
            folder / "online" / "identification.json",
            outputs,
        )


def test_a_run_ends_cleanly(run: Run) -> None:
    """The generator ends by itself and Ctrl-C ends the others, all with code 0 and without a
    traceback."""
    assert run.generator.process.returncode == 0
    assert set(run.codes.values()) == {0}, run.outputs
    assert "Traceback" not in run.outputs


def test_the_estimate_converges_to_the_truth(run: Run) -> None:
    """The errors of all parameters are within two of the deviations that the identifier states, and
    these shrink.

    The errors count together, with their correlations: with exact encoders all parameters hang on
    one scale, that of the torques, so that errors one by one would be one draw of chance, repeated.
    """
    online = Identification.load(run.online)
    assert sum(e.verdict == "well" for e in online.estimates) > 10
    true = np.array([e.nominal for e in online.estimates])
    assert np.sqrt(chi_square(online, true) / len(true)) < 2.0
    first = run.estimates[0]
    last = run.estimates[-1]
    assert last.samples > first.samples
    assert np.median(np.array(last.std) / np.array(first.std)) < 1.0


def test_the_recording_holds_the_whole_run(run: Run) -> None:
    """All topics are in the bag, both sides with the same stamps, a sample every millisecond of the
    motion."""
    recording = read_recording(run.bag)
    assert recording.joints == JOINTS
    assert recording.robot_description
    samples = recording.samples()
    assert len(samples) > 10_000
    assert samples.stamp_ns[-1] >= recording.reference.stamp_ns[-1]
    assert set(np.diff(samples.stamp_ns)) == {STEP_NS}


def test_online_and_offline_agree(graph: Graph, run: Run) -> None:
    """The samples of a bag give the same estimate over the graph as fed to the estimator at once,
    to rounding.

    With `print`, every estimate is a line of JSON on stdout, for a program that shows the course.
    """
    folder = graph.folder / "online"
    identifier = graph.start("identifier", save_to=folder, save_at_exit=True, print=True)
    replayer = graph.start(
        "replayer", bag=run.bag, topics="['/joint_states', '/motor_states']", rate=3.0
    )
    graph.until(lambda: replayer.process.poll() is not None, "the bag ends")
    assert identifier.stop() == 0
    printed = [json.loads(line) for line in identifier.output.splitlines() if line.startswith("{")]
    assert len(printed) > 1 and printed[0]["samples"] > 0
    assert (
        len(printed[0]["name"])
        == len(printed[0]["value"])
        == len(printed[0]["std"])
        == len(printed[0]["unit"])
    )
    online = Identification.load(folder / "identification.json")
    estimator = identifier_of(load_robot(None))
    estimator.add(read_recording(run.bag).samples())
    estimator.finish()
    offline = estimator.estimate()
    assert offline.samples == online.samples
    assert [e.name for e in offline.estimates] == [e.name for e in online.estimates]
    np.testing.assert_allclose((online.Psi_base - offline.Psi_base) / offline.std, 0.0, atol=1e-3)


def test_a_replay_says_what_was_recorded(graph: Graph, run: Run) -> None:
    """The replayer publishes every recorded sample in order, with its stamp, and the clock beside
    it."""
    clock = graph.listen(Clock, "/clock")
    messages = graph.listen(JointState, "/joint_states")
    recorded = read_recording(run.bag).link
    replayer = graph.start("replayer", bag=run.bag, topics="['/joint_states']", rate=3.0)
    graph.until(lambda: replayer.process.poll() is not None, "the bag ends")
    graph.until(lambda: len(messages) == len(recorded), "all samples are here")
    assert replayer.process.returncode == 0
    np.testing.assert_array_equal(stamps(messages), recorded.stamp_ns)
    np.testing.assert_array_equal([list(m.position) for m in messages], recorded.position)
    times = [c.clock.sec * 10**9 + c.clock.nanosec for c in clock]
    assert times == sorted(times)


def test_samples_come_in_order_one_a_millisecond(graph: Graph) -> None:
    """With a clock of its own, the arm's samples follow each other by exactly a millisecond on all
    three topics."""
    kinds = {
        "/joint_states": JointState,
        "/motor_states": JointState,
        "/joint_torques": JointTorques,
    }
    heard = {topic: graph.listen(kind, topic) for topic, kind in kinds.items()}
    clock = graph.listen(Clock, "/clock")
    description = graph.listen(String, "/robot_description")
    graph.start("simulator", real_time_factor=0.5)
    graph.until(lambda: min(map(len, heard.values())) > 500, "500 samples")
    for messages in heard.values():
        assert set(np.diff(stamps(messages))) == {STEP_NS}
    assert clock
    assert "<robot" in description[0].data
    late: list[String] = graph.listen(String, "/robot_description")
    graph.until(lambda: late, "a late subscriber gets the description too")


def test_samples_carry_the_time_of_day(graph: Graph) -> None:
    """In real time a stamp is the time at which the sample was taken, on the grid of
    milliseconds."""
    messages = graph.listen(JointState, "/joint_states")
    graph.start("simulator")
    graph.until(lambda: len(messages) > 50, "samples")
    newest = stamps(messages)[-1]
    assert newest % STEP_NS == 0
    assert abs(time.time_ns() - newest) < 2 * 10**9


@pytest.mark.nightly
def test_an_arm_faster_than_real_time_is_moved_on_its_own_clock(graph: Graph) -> None:
    """With /clock the reference keeps to the arm's time, and the whole motion is run without a
    break."""
    clock = graph.listen(Clock, "/clock")
    status: list[DiagnosticArray] = graph.listen(DiagnosticArray, "/diagnostics")
    recorder = graph.start("recorder", bag=graph.folder / "bag")
    graph.start("simulator", real_time_factor=1.5)
    generator = graph.start(
        "trajectory_generator", trajectory=lively_excitation(graph.folder, 3.0), use_sim_time=True
    )
    graph.until(lambda: generator.process.poll() is not None, "the motion ends")
    assert generator.process.returncode == 0
    assert recorder.stop() == 0
    recording = read_recording(graph.folder / "bag")
    assert set(np.diff(recording.motor.stamp_ns)) == {STEP_NS}
    # On a busy machine the recorder finds the arm's topics some tenths of a second after the motion
    # has begun.
    heard = recording.reference.stamp_ns >= recording.motor.stamp_ns[0]
    assert np.mean(heard) > 0.5
    stamps = recording.reference.stamp_ns[heard]
    reference = recording.reference.position[heard, 0]
    followed = np.interp(stamps, recording.motor.stamp_ns, recording.motor.position[:, 0])
    np.testing.assert_allclose(followed, reference, atol=0.01)
    assert clock
    assert not any("stopped during motion" in message.status[0].message for message in status)


def held_up(graph: Graph, node: NodeProcess, seconds: float) -> None:
    """Stop a process, and let it go on after some seconds, as a machine does that is busy with
    other things."""
    node.process.send_signal(signal.SIGSTOP)
    end = time.monotonic() + seconds
    graph.until(lambda: time.monotonic() > end, "the pause is over")
    node.process.send_signal(signal.SIGCONT)


def reference_and_motion(graph: Graph) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the recorded reference, and the motor angles at its stamps; and all stamps of the
    motors."""
    recording = read_recording(graph.folder / "bag")
    stamp_ns = recording.motor.stamp_ns
    angles = [
        np.interp(recording.reference.stamp_ns, stamp_ns, column)
        for column in recording.motor.position.T
    ]
    return recording.reference.position, np.stack(angles, axis=1), stamp_ns


def test_the_clock_of_the_arm_waits_for_a_generator_that_is_held_up(graph: Graph) -> None:
    """With /clock a pause of the stream costs real time alone: in the arm's time the motion is run
    as it was meant."""
    clock = graph.listen(Clock, "/clock")
    recorder = graph.start("recorder", bag=graph.folder / "bag")
    graph.start("simulator", real_time_factor=1.5)
    generator = graph.start(
        "trajectory_generator", trajectory=lively_excitation(graph.folder, 4.0), use_sim_time=True
    )
    graph.until(lambda: clock and "streaming 4.0 s" in generator.output, "the motion is announced")
    begun = clock[-1].clock.sec
    graph.until(lambda: clock[-1].clock.sec > begun + 2, "the motion is under way")
    held_up(graph, generator, 3.0)
    graph.until(lambda: generator.process.poll() is not None, "the motion ends")
    assert recorder.stop() == 0
    reference, followed, stamp_ns = reference_and_motion(graph)
    assert set(np.diff(stamp_ns)) == {STEP_NS}
    np.testing.assert_allclose(followed, reference, atol=0.01)


def test_an_arm_that_is_held_up_in_real_time_loses_no_sample(graph: Graph) -> None:
    """After two seconds of standstill the simulator catches up: a sample every millisecond, on the
    reference."""
    heard = graph.listen(JointState, "/motor_states")
    recorder = graph.start("recorder", bag=graph.folder / "bag")
    simulator = graph.start("simulator")
    generator = graph.start("trajectory_generator", trajectory=lively_excitation(graph.folder, 5.0))
    graph.until(lambda: "streaming 5.0 s" in generator.output, "the motion is announced")
    end = time.monotonic() + 2.0
    graph.until(lambda: time.monotonic() > end, "the motion is under way")
    held_up(graph, simulator, 2.0)
    graph.until(lambda: generator.process.poll() is not None, "the motion ends")
    over = time.time_ns()
    graph.until(lambda: stamps(heard[-1:])[0] > over, "the arm has caught up")
    assert recorder.stop() == 0
    reference, followed, stamp_ns = reference_and_motion(graph)
    assert set(np.diff(stamp_ns)) == {STEP_NS}
    np.testing.assert_allclose(followed, reference, atol=0.01)


def test_the_generator_goes_on_with_an_arm_that_was_started_again(graph: Graph) -> None:
    """Where the simulator ends in the middle of a motion, the generator waits for the next one and
    begins anew."""
    trajectory = lively_excitation(graph.folder, 4.0)
    simulator = graph.start("simulator")
    generator = graph.start("trajectory_generator", trajectory=trajectory)
    graph.until(lambda: "streaming 4.0 s" in generator.output, "the motion is announced")
    assert simulator.stop() == 0
    graph.until(lambda: "waiting for the arm" in generator.output, "the generator misses the arm")
    assert generator.process.poll() is None
    graph.start("simulator")
    graph.until(lambda: generator.process.poll() is not None, "the motion ends")
    assert generator.process.returncode == 0 and generator.output.count("streaming 4.0 s") == 2


def test_two_clocks_are_a_mistake(graph: Graph) -> None:
    """A generator on the time of day refuses an arm on a clock of its own, and says what to set."""
    graph.start("simulator", real_time_factor=0.5)
    generator = graph.start("trajectory_generator", trajectory=lively_excitation(graph.folder, 3.0))
    assert generator.wait() == 2
    assert "use_sim_time" in generator.output.splitlines()[-1]


def test_an_effect_is_switched_on_by_a_parameter(graph: Graph) -> None:
    """An offset of a torque sensor, given as a parameter, shows in that joint's torque."""
    messages = graph.listen(JointTorques, "/joint_torques")
    graph.start(
        "simulator", effects="['motor_torque_offset:joint_2:offset=50.0']", torque_noise=0.0
    )
    graph.until(lambda: len(messages) > 10, "samples")
    with ros_graph(graph.folder.parent) as other:
        plain = other.listen(JointTorques, "/joint_torques")
        other.start("simulator", torque_noise=0.0)
        other.until(lambda: len(plain) > 10, "samples")
    difference = np.array(messages[5].motor_torque) - np.array(plain[5].motor_torque)
    # The two arms are not in step: the controller has moved them a little, by different amounts.
    np.testing.assert_allclose(difference, [0.0, 50.0, 0.0], atol=1.0)


def test_effects_are_set_and_cleared_while_the_arm_runs(graph: Graph) -> None:
    """`ros2 param set` takes a list of effects, an empty list for none, and refuses what is no list
    of texts."""
    simulator = graph.start("simulator", real_time_factor=0.5)
    friction = "viscous_friction:joint_1:coefficient=2.0"
    # The second is what `ros2 param set /simulator effects "[]"` sends.
    one = ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=[friction])
    none = ParameterValue(type=ParameterType.PARAMETER_BOOL_ARRAY)
    number = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=3)
    results = []
    for value in (one, none, number):
        request = SetParameters.Request(parameters=[RosParameter(name="effects", value=value)])
        results += graph.call(SetParameters, "/simulator/set_parameters", request).results
    assert [result.successful for result in results] == [True, True, False], results
    assert "not a list of texts" in results[2].reason
    graph.until(lambda: "effects: none" in simulator.output, "it is reported")
    assert simulator.output.index(f"effects: {friction}") < simulator.output.index("effects: none")


def test_a_killed_recorder_leaves_a_readable_bag(graph: Graph) -> None:
    """After kill -9 the bag holds everything up to the last second."""
    messages = graph.listen(JointState, "/joint_states")
    status = graph.status("recorder")
    recorder = graph.start("recorder", bag=graph.folder / "bag")
    graph.start("simulator", real_time_factor=0.5)
    # By its own count: on a busy machine it may hear the arm later than this test does.
    graph.until(
        lambda: int(status.get("/joint_states", 0)) > 1000, "a second of samples is recorded"
    )
    recorder.stop(signal.SIGKILL)
    last = stamps(messages)[-1]
    recording = read_recording(graph.folder / "bag")
    assert set(np.diff(recording.link.stamp_ns)) == {STEP_NS}
    assert last - recording.link.stamp_ns[-1] < 10**9


def test_a_simulator_that_publishes_stays_when_another_source_turns_up(graph: Graph) -> None:
    """It says who publishes too, from its first samples on: the arm is moving, and the newcomer is
    the mistake."""
    status = graph.listen(DiagnosticArray, "/diagnostics")
    samples = graph.listen(JointState, "/joint_states")
    simulator = graph.start("simulator")
    graph.until(lambda: samples, "the arm moves")
    graph.peer.create_publisher(JointState, "/motor_states", qos("/motor_states"))
    graph.until(
        lambda: any(
            "/peer also publishes /motor_states" in array.status[0].message for array in status
        ),
        "the newcomer is warned of",
    )
    assert simulator.stop() == 0
    assert "error" not in simulator.output


ABSURD_POSITIONS = {
    "fewer positions than joints": {"position": [0.0]},
    "a huge one": {"position": [0.0, 1e308, 0.0]},
    "no number": {"position": [0.0, 0.0, float("nan")]},
    "a joint twice": {"name": ["joint_1", "joint_1", "joint_2"], "position": [0.0, 0.0, 0.0]},
}


def test_states_without_a_place_of_the_arm_are_refused_by_the_generator(
    graph: Graph, tmp_path: Path
) -> None:
    """A generator that never learns where the arm is says what it hears, and ends with code 2."""
    trajectory = lively_excitation(tmp_path, 2.0)
    for k, sent in enumerate(ABSURD_POSITIONS.values()):
        space = f"arm_{k}"
        publisher = graph.peer.create_publisher(
            JointState, f"/{space}/motor_states", qos("/motor_states")
        )
        message = JointState(**{"name": list(JOINTS), **sent})

        def say(publisher=publisher, message=message) -> None:
            message.header.stamp = graph.peer.get_clock().now().to_msg()
            publisher.publish(message)

        graph.peer.create_timer(0.05, say)
        graph.start("trajectory_generator", "-r", f"__ns:=/{space}", trajectory=trajectory)
    graph.until(
        lambda: all(node.process.poll() is not None for node in graph.nodes),
        "the generators give up",
    )
    said = ("1 positions for 3 joints", "of 1e+308 rad for joint_2", "of nan rad", "a joint twice")
    for node, words in zip(graph.nodes, said, strict=True):
        assert node.wait() == 2
        assert (
            words in node.output and "Traceback" not in node.output and "Warning" not in node.output
        )


def test_absurd_references_leave_the_arm_as_it_is(graph: Graph) -> None:
    """One message of years of points, or of impossible numbers, is refused in words; the arm goes
    on."""
    samples = graph.listen(JointState, "/joint_states")
    status = graph.status("simulator")
    simulator = graph.start("simulator", rate=250.0)
    publishers = {
        topic: graph.peer.create_publisher(JointTrajectory, topic, qos("/reference"))
        for topic in ("/reference", "/simulator/joint_trajectory")
    }
    graph.until(lambda: samples, "the arm is there")
    graph.until(lambda: all(p.get_subscription_count() for p in publishers.values()), "it listens")

    def at(seconds: float, *position: float) -> JointTrajectoryPoint:
        whole, part = divmod(round(seconds * 1e9), 10**9)
        return JointTrajectoryPoint(
            positions=position or (0.0,) * 3, time_from_start=Duration(sec=whole, nanosec=part)
        )

    sent = {
        "no positions": [JointTrajectoryPoint()],
        "not a number": [at(1.0, *[float("nan")] * 3)],
        "huge": [at(0.0), at(1.0, *[1e308] * 3)],
        "descending": [at(2.0), at(1.0)],
        "for 68 years": [at(0.0), at(2.0**31 - 1)],
        "too many": [at(1e-3 * k) for k in range(20_001)],
    }
    for publisher in publishers.values():
        for points in sent.values():
            message = JointTrajectory(joint_names=list(JOINTS), points=points)
            publisher.publish(message)
            message.header.stamp = graph.peer.get_clock().now().to_msg()
            publisher.publish(message)
        publisher.publish(
            JointTrajectory(joint_names=["x" * 100_000, "\x1b[31m", "[r]"], points=[at(1.0)])
        )
    publishers["/simulator/joint_trajectory"].publish(
        JointTrajectory(joint_names=list(JOINTS), points=[at(0.5, 0.02, 0.02, 0.02)])
    )
    graph.until(lambda: abs(samples[-1].position[0] - 0.02) < 2e-3, "a proper goal is reached")
    graph.until(
        lambda: int(status.get("refused reference messages", 0)) == 26,
        "what was refused is counted",
    )
    assert simulator.stop() == 0
    assert "Traceback" not in simulator.output and "Warning" not in simulator.output
    assert "\x1b[31m[r]" not in simulator.output
    assert len(simulator.output) < 20_000


def test_the_identifier_obeys_its_services(graph: Graph, run: Run) -> None:
    """Pause stops the counting, save writes a result that loads, reset forgets."""
    status = graph.status("identifier")
    graph.start("identifier", save_to=graph.folder / "saved")
    graph.until(
        lambda: "no messages on /joint_states" in status.get("said", ""), "a silent arm is reported"
    )
    graph.start("replayer", bag=run.bag, topics="['/joint_states', '/motor_states']", rate=4.0)
    graph.until(lambda: int(status.get("samples used", 0)) > 4000, "samples are used")
    answer = graph.call(Trigger, "/identifier/save", Trigger.Request())
    assert answer.success, answer.message
    assert Identification.load(graph.folder / "saved" / "identification.json").samples > 4000
    assert graph.call(SetBool, "/identifier/pause", SetBool.Request(data=True)).success
    graph.until(lambda: "paused" in status["said"], "the pause is reported")
    assert graph.call(Trigger, "/identifier/reset", Trigger.Request()).success
    graph.until(lambda: status["samples used"] == "0", "all is forgotten")


MISTAKES = {
    "no such arm of the monitor": (
        "gap_monitor",
        {"robot": "/nowhere/arm.yaml"},
        "/nowhere/arm.yaml",
    ),
    "no such effect of the monitor": (
        "gap_monitor",
        {"known": "['coulomb_frictoin']"},
        "coulomb_friction",
    ),
    "no such arm": ("simulator", {"robot": "/nowhere/arm.yaml"}, "/nowhere/arm.yaml"),
    "no such model": ("simulator", {"model": "mod9"}, "mod9"),
    "no such effect": ("simulator", {"effects": "['coulomb_frictoin']"}, "coulomb_friction"),
    "a number out of range": ("simulator", {"torque_noise": -1.0}, "torque_noise"),
    "a text for a number": ("simulator", {"torque_noise": "loud"}, "torque_noise"),
    "no trajectory": ("trajectory_generator", {}, "trajectory"),
    "a bag that is not there": ("replayer", {"bag": "/nowhere/bag"}, "/nowhere/bag"),
    "a folder that is there": ("recorder", {"bag": "/tmp"}, "/tmp"),
    "a folder that cannot be made": ("recorder", {"bag": "/proc/bag"}, "/proc/bag"),
}


def test_mistakes_are_answered_in_one_line(graph: Graph) -> None:
    """Each node ends with code 2 and a line that names what was wrong."""
    nodes = {
        mistake: graph.start(name, **parameters)
        for mistake, (name, parameters, _) in MISTAKES.items()
    }
    for mistake, node in nodes.items():
        assert node.wait() == 2, (mistake, node.output)
        (line,) = node.output.splitlines()
        assert line.startswith("error: ") and MISTAKES[mistake][2] in line
