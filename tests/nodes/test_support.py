"""What the nodes do that needs no graph: pairing, the streamed reference, the pace, messages as
bytes."""

import signal
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from elastic_arm.errors import ElasticArmError, RecordingError
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.nodes.following.reference import ReferenceQueue
from elastic_arm.nodes.following.splines import QUINTIC, Points, Row
from elastic_arm.nodes.recorder import Recorder, installed_definition
from elastic_arm.nodes.replayer import Playback
from elastic_arm.nodes.simulator import Pace
from elastic_arm.nodes.support import running
from elastic_arm.nodes.support.collecting import Collector
from elastic_arm.nodes.support.pairing import Pairing
from elastic_arm.nodes.support.running import run
from elastic_arm.nodes.support.wire import Form, Inbox
from elastic_arm.nodes.trajectory_generator import Plan
from elastic_arm.recording import ChannelMap, limits, load_channels, message_types
from elastic_arm.recording.message_types import parse_definition
from elastic_arm.recording.storage.messages import Message


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """A node that has ended ignores signals; the tests after it do not."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


MS = 1_000_000


def rows(stamps: list[int], offset: float = 0.0) -> np.ndarray:
    """Return one recognisable row per stamp."""
    return np.array(stamps, dtype=float)[:, None] * [1.0, 2.0] + offset


def feed(pairing: Pairing, link: list[int], motor: list[int]) -> None:
    pairing.add_link(np.array(link), rows(link))
    pairing.add_motor(np.array(motor), rows(motor, 0.5))


# Pairing


def test_samples_of_equal_stamp_are_paired_in_order() -> None:
    """Rows of both sides stand beside the stamp they came with, in order of time."""
    pairing = Pairing(window_ns=0)
    feed(pairing, [1, 2, 3], [1, 2, 3])
    pairs = pairing.take()
    assert pairs.stamp_ns.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(pairs.link, rows([1, 2, 3]))
    np.testing.assert_array_equal(pairs.motor, rows([1, 2, 3], 0.5))


PAIRED: dict[str, tuple[int, list[tuple[list[int], list[int]]], list[int], dict[str, int]]] = {
    # window, batches of link and motor, stamps that are handed out in all, and what is counted
    "overtaken within the window": (
        10,
        [([1, 3, 2, 4], [1, 2, 3, 4])],
        [1, 2, 3, 4],
        {"reordered": 1},
    ),
    "repeated, in another batch too": (
        10,
        [([1, 2, 2], [1, 2]), ([2, 3], [3])],
        [1, 2, 3],
        {"repeated": 2},
    ),
    "older than what was handed out": (
        0,
        [([1, 3], [1, 3]), ([2, 4], [2, 4])],
        [1, 3, 4],
        {"late": 2, "reordered": 2},
    ),
    "without a partner": (5, [([1, 2, 3], [1, 3]), ([9], [9])], [1, 3, 9], {"unmatched": 1}),
    "before the other topic was found": (
        5,
        [([1, 2, 3, 4, 5], [3, 5]), ([11], [11])],
        [3, 5, 11],
        {"early": 2, "unmatched": 1},
    ),
    "of a clock set back": (
        0,
        [([5_000 * MS],) * 2, ([1 * MS, 2 * MS],) * 2],
        [5_000 * MS, 1 * MS, 2 * MS],
        {"restarts": 1},
    ),
}


@pytest.mark.parametrize("what", PAIRED)
def test_samples_that_come_otherwise_are_put_in_order_or_counted(what: str) -> None:
    """What is handed out increases within a run, and every sample that is not is counted by the
    reason."""
    window, batches, expected, counts = PAIRED[what]
    pairing = Pairing(window_ns=window)
    handed = list[int]()
    for batch in (*batches, None):
        if batch is not None:
            feed(pairing, *batch)
        pairs = pairing.take(everything=batch is None)
        handed += [] if pairs is None else pairs.stamp_ns.tolist()
    assert handed == expected
    assert {name: count for name, count in vars(pairing.losses).items() if count} == counts


def test_a_silent_peer_costs_no_memory() -> None:
    """With one side silent, no more samples are held than the capacity."""
    pairing = Pairing(capacity=100)
    for begin in range(0, 5_000, 50):
        stamps = np.arange(begin, begin + 50) * MS
        pairing.add_link(stamps, np.zeros((50, 2)))
        assert pairing.take() is None
    feed(pairing, [4_999 * MS], [4_999 * MS])
    assert pairing.losses.unmatched == 4_900


@settings(deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 40)), max_size=80), st.integers(0, 10))
def test_handed_out_stamps_strictly_increase(arrivals: list[tuple[bool, int]], window: int) -> None:
    """Whatever arrives in whatever order, what is handed out increases, and every sample is
    accounted for."""
    pairing = Pairing(window_ns=window)
    handed: list[int] = []
    for is_link, stamp in arrivals:
        (pairing.add_link if is_link else pairing.add_motor)(np.array([stamp]), rows([stamp]))
        if (pairs := pairing.take()) is not None:
            handed += pairs.stamp_ns.tolist()
    if (pairs := pairing.take(everything=True)) is not None:
        handed += pairs.stamp_ns.tolist()
    assert handed == sorted(set(handed))
    losses = pairing.losses
    both = {side for side, _ in arrivals} == {True, False}
    counted = 2 * len(handed) + losses.repeated + losses.late + losses.early + losses.unmatched
    assert counted == len(arrivals) or not both


# Reference


def sine(stamps: np.ndarray) -> Row:
    t = (stamps * 1e-9)[:, None] * np.ones(2)
    return Row(np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t))


def test_the_reference_between_points_follows_the_motion() -> None:
    """Points off the grid, in messages cut anywhere, are brought onto it to within the cubic's
    error."""
    queue = ReferenceQueue(np.zeros(2), origin_ns=0, step_ns=MS)
    stamps = np.arange(1000) * MS + 370_000
    for begin in range(0, 1000, 21):
        part = stamps[begin : begin + 21]
        queue.add(through(part, sine(part)))
    got = [queue.at(step) for step in range(1, 700)]
    expected = sine(np.arange(1, 700) * MS)
    bound = 3**4 * 1e-12 / 384  # |q''''| h^4 / 384
    np.testing.assert_allclose(
        [row.position for row in got], expected.position, rtol=0, atol=bound + 1e-15
    )
    np.testing.assert_allclose([row.velocity for row in got], expected.velocity, atol=1e-8)
    np.testing.assert_allclose([row.acceleration for row in got], expected.acceleration, atol=1e-4)
    assert queue.late == queue.starved == queue.delay == 0


def through(stamps: np.ndarray, row: Row) -> Points:
    """Points that state their accelerations."""
    return Points(stamps, row, np.full(len(stamps), QUINTIC))


def gone_through(queue: ReferenceQueue, steps: range) -> Row:
    """Return the rows of consecutive steps, (N, n) each."""
    rows = [queue.at(step) for step in steps]
    return Row(*(np.array(values) for values in zip(*rows, strict=True)))


def assert_smooth(motion: Row, acceleration: float) -> None:
    """Positions, velocities and accelerations belong together, and the last keep within a bound."""
    np.testing.assert_allclose(
        np.diff(motion.position, axis=0) * 1e3, motion.velocity[1:], atol=0.01
    )
    assert np.abs(np.diff(motion.velocity, axis=0)).max() * 1e3 < acceleration
    assert np.abs(motion.acceleration).max() < acceleration


def test_a_stream_that_breaks_off_leaves_the_arm_standing_on_its_path() -> None:
    """The arm slows down before the last point and stands there; that the stream fell behind is
    counted once."""
    queue = ReferenceQueue(np.zeros(2), origin_ns=0, step_ns=MS)
    stamps = np.arange(1, 701) * MS
    queue.add(through(stamps, sine(stamps)))
    motion = gone_through(queue, range(1, 2500))
    np.testing.assert_allclose(motion.position[:499], sine(stamps[:499]).position, atol=1e-12)
    assert_smooth(motion, 30.0)  # of the sine 9 rad/s²; its speed, 3 rad/s, is lost within BRAKING
    np.testing.assert_allclose(motion.position[-1], sine(stamps[-1:]).position[0], atol=0.01)
    assert not motion.velocity[-1].any()
    assert not motion.acceleration[-1].any()
    assert queue.starved == 1


def test_a_stream_that_falls_behind_is_picked_up_where_it_was_left() -> None:
    """After a pause of a second the arm goes on from where it stood: later, and without a jump or a
    part left out."""
    queue = ReferenceQueue(np.zeros(2), origin_ns=0, step_ns=MS)
    stamps = np.arange(1, 3001) * MS
    queue.add(through(stamps[:600], sine(stamps[:600])))
    before = gone_through(queue, range(1, 1600))
    queue.add(through(stamps[600:], sine(stamps[600:])))
    after = gone_through(queue, range(1600, 3500))
    motion = Row(*(np.concatenate(both) for both in zip(before, after, strict=True)))
    assert_smooth(motion, 30.0)
    np.testing.assert_allclose(
        after.position[-1], sine(np.array([(3499 - queue.delay) * MS])).position[0], atol=1e-9
    )
    assert 600 < queue.delay < 1600
    assert queue.starved == 1


def test_a_motion_that_begins_late_is_followed_from_its_beginning() -> None:
    """Points that lie in the past when they arrive are followed all the same, so many steps
    later."""
    queue = ReferenceQueue(np.zeros(2), origin_ns=0, step_ns=MS)
    gone_through(queue, range(1, 6))
    stamps = np.arange(1, 701) * MS
    queue.add(through(stamps, sine(stamps)))
    motion = gone_through(queue, range(6, 400))
    np.testing.assert_allclose(motion.position, sine(stamps[:394]).position, atol=1e-12)
    assert queue.delay == 5
    assert queue.late == queue.starved == 0


def test_a_motion_in_time_takes_the_delay_away() -> None:
    """Behind a motion that ended at rest, the next one is followed on its stamps."""
    queue = ReferenceQueue(np.zeros(1), origin_ns=0, step_ns=MS)

    def pulse(count: int) -> Row:
        s = np.linspace(0.0, 1.0, count)[:, None]
        return Row(s**2 * (3 - 2 * s), 6 * s * (1 - s), 6 - 12 * s)

    gone_through(queue, range(1, 101))
    queue.add(through(np.arange(1, 1001) * MS, pulse(1000)))
    gone_through(queue, range(101, 1200))
    queue.add(through(np.arange(2001, 3001) * MS, pulse(1000)))
    motion = gone_through(queue, range(1200, 2501))
    assert motion.position[800] == 1.0
    np.testing.assert_allclose(motion.position[801:], pulse(1000).position[:500], atol=1e-12)
    assert queue.delay == 0


def test_points_of_another_clock_are_not_followed() -> None:
    """Points that are older than any delay are left out and counted."""
    queue = ReferenceQueue(np.zeros(2), origin_ns=0, step_ns=MS)
    queue.at(20_000)
    stamps = np.arange(1, 11) * MS
    queue.add(through(stamps, sine(stamps)))
    assert not queue.at(20_001).position.any()
    assert queue.late == 10


def test_a_new_trajectory_replaces_what_lies_behind_its_start() -> None:
    """A message whose first point lies within the stream takes over from there."""
    queue = ReferenceQueue(np.zeros(1), origin_ns=0, step_ns=MS)
    stamps = np.arange(1, 11) * MS
    still = np.zeros((10, 1))
    queue.add(through(stamps, Row(still, still, still)))
    queue.add(through(stamps + 5 * MS, Row(still + 1, still, still)))
    positions = [queue.at(step).position[0] for step in range(1, 16)]
    assert positions == [0.0] * 5 + [1.0] * 10


# Pace


def test_a_late_step_does_not_shift_the_schedule() -> None:
    """Steps are due at absolute times: one that comes 3 ms late leaves the next where it was."""
    pace = Pace(rate=1000.0)
    assert pace.wait(10.0) == 0.0
    pace.stepped(10.003)
    assert pace.wait(10.003) == pytest.approx(-0.002)
    assert pace.slipped == 0.0


def test_falling_far_behind_is_admitted() -> None:
    """Beyond the patience the schedule moves, and the lost time is counted."""
    pace = Pace(rate=1000.0, patience=0.5)
    pace.wait(0.0)
    pace.stepped(2.0)
    assert pace.slipped == pytest.approx(1.999)
    assert pace.wait(2.0) == 0.0


def test_the_factor_sets_the_speed() -> None:
    """At twice real time 2000 steps of a 1 kHz arm are due in a second, and that counts as the pace
    held."""
    pace = Pace(rate=1000.0, factor=2.0)
    pace.wait(0.0)
    for step in range(2000):
        pace.stepped(step * 0.0005)
    assert pace.wait(1.0) == pytest.approx(0.0, abs=1e-9)
    assert pace.achieved(1.0) == pytest.approx(1.0)


# Messages as bytes


def joint_state(names: list[str], stamp_ns: int = 0, scale: float = 1.0) -> JointState:
    message = JointState(name=names)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    message.position = array("d", [scale * (i + 1) for i in range(len(names))])
    message.velocity = array("d", [scale * (i + 1) * 10 for i in range(len(names))])
    return message


def test_a_filled_form_is_the_message() -> None:
    """The bytes of a filled form are those of the message with these numbers."""
    form = Form("sensor_msgs/msg/JointState", joint_state(["a", "bb"]))
    data = form.filled(
        3_000_000_007, position=np.array([4.0, 8.0]), velocity=np.array([40.0, 80.0])
    )
    assert deserialize_message(data, JointState) == joint_state(["a", "bb"], 3_000_000_007, 4.0)


def test_an_inbox_gives_back_what_came_in() -> None:
    """Names, stamps and numbers of many messages come out as arrays, messages of another layout
    apart."""
    inbox = Inbox("sensor_msgs/msg/JointState")
    for stamp in (1, 2, 3):
        inbox.put(serialize_message(joint_state(["a", "b"], stamp, float(stamp))))
    inbox.put(serialize_message(joint_state(["b", "a", "c"], 4, 4.0)))
    (names, stamps, numbers), (other_names, other_stamps, _) = inbox.take()
    assert names == ("a", "b")
    assert stamps.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(numbers["position"], [[1, 2], [2, 4], [3, 6]])
    assert other_names == ("b", "a", "c")
    assert other_stamps.tolist() == [4]
    assert not list(inbox.take())


@pytest.mark.parametrize(
    "spoil",
    [
        lambda b: b"",
        lambda b: b[:2],
        lambda b: b[:-5],
        lambda b: b"\x07\x07" + b[2:],
        lambda b: b[:12] + b"\xff" * 4 + b[16:],
        lambda b: b[:16] + b"\xff" * 8 + b[24:],
    ],
)
def test_messages_that_do_not_fit_their_type_are_counted(spoil: Callable[[bytes], bytes]) -> None:
    """Whoever publishes bytes that are no message of the type stops no node: the sound ones are
    read."""
    collector = Collector(("a", "b"))
    sound = serialize_message(joint_state(["a", "b"], stamp_ns=MS))
    for inbox in collector.inboxes.values():
        for message in (sound, spoil(sound)):
            inbox.put(message)
    samples = collector.take(everything=True)
    assert samples is not None and len(samples) == 1
    assert "2 messages cannot be read" in collector.problems()


def test_messages_that_all_look_different_cost_no_time() -> None:
    """Of 2000 messages with other names each, as many layouts are looked at as a bag may have; the
    rest is counted."""
    inbox = Inbox("sensor_msgs/msg/JointState")
    for k in range(2000):
        inbox.put(serialize_message(joint_state([f"{k:04d}"])))
    assert len(list(inbox.take())) == limits.LAYOUTS
    assert inbox.unreadable == 2000 - limits.LAYOUTS


def test_a_full_inbox_drops_the_oldest_and_says_so() -> None:
    """A node that is busy for too long loses the oldest messages, counted, and no memory."""
    inbox = Inbox("sensor_msgs/msg/JointState", capacity=2)
    for stamp in (1, 2, 3):
        inbox.put(serialize_message(joint_state(["a"], stamp)))
    ((_, stamps, _),) = inbox.take()
    assert stamps.tolist() == [2, 3]
    assert inbox.overflowed == 1


# Collecting


def states(names: list[str], stamp_ms: int, **numbers: list[float]) -> bytes:
    """Return a message with these fields as it comes from the wire."""
    message = JointState(
        name=names, **{field: array("d", values) for field, values in numbers.items()}
    )
    message.header.stamp.nanosec = stamp_ms * MS
    return serialize_message(message)


def collector(sides: str = "both") -> Collector:
    return Collector(("a", "b"), sides)


def test_joints_in_another_order_find_their_columns() -> None:
    """Joints are matched by name on either topic, and joints of others are left out."""
    box = collector()
    box.inboxes["/joint_states"].put(states(["b", "gripper", "a"], 1, position=[2.0, 9.0, 1.0]))
    box.inboxes["/motor_states"].put(states(["a", "b"], 1, position=[3.0, 4.0], effort=[5.0, 6.0]))
    samples = box.take(everything=True)
    assert samples.q.tolist() == [[1.0, 2.0]]
    assert samples.theta.tolist() == [[3.0, 4.0]]
    assert samples.tau_m.tolist() == [[5.0, 6.0]]
    assert samples.tau_J is None
    assert samples.dq is None


def driver_map(folder: Path, text: str) -> ChannelMap:
    (folder / "map.yaml").write_text(text)
    return load_channels(folder / "map.yaml")


DRIVER = """
defaults:
  motor:
    position: {topic: /arm/joint_states, unit: deg, ratio: 100}
    effort: {topic: /arm/joint_states, unit: A, torque_constant: 0.2, ratio: 100}
joints: {a: {name: axis_1}, b: {name: axis_2, motor: {effort: {sign: -1}}}}
"""


def test_a_driver_that_publishes_currents_is_read_by_a_map(tmp_path: Path) -> None:
    """Degrees and amperes of motors under the driver's names become rad and Nm at the output;
    others are foreign."""
    box = Collector(("a", "b"), channels=driver_map(tmp_path, DRIVER))
    (inbox,) = box.inboxes.values()
    assert list(box.inboxes) == ["/arm/joint_states"] and box.channels == (
        "theta",
        "dtheta",
        "tau_m",
    )
    inbox.put(states(["axis_2", "axis_1"], 1, position=[18000.0, 9000.0], effort=[2.0, 1.0]))
    inbox.put(states(["axis_2"], 2, position=[18000.0], effort=[2.0]))
    samples = box.take(everything=True)
    assert (
        samples is not None
        and samples.theta is not None
        and samples.tau_m is not None
        and samples.q is None
    )
    np.testing.assert_allclose(samples.theta, [[np.pi / 2, np.pi]])
    np.testing.assert_allclose(samples.tau_m, [[20.0, -40.0]])
    assert box.faults.foreign == 1


def test_a_duty_is_left_to_bags(tmp_path: Path) -> None:
    """Live nodes do not make torques of it."""
    text = DRIVER.replace("unit: A, torque_constant: 0.2, ratio: 100", "full_scale: 885")
    text = text.replace("effort:", "pwm:")
    with pytest.raises(RecordingError, match="has pwm, which live nodes do not convert"):
        Collector(("a", "b"), channels=driver_map(tmp_path, text))


def test_both_sides_may_come_on_one_topic(tmp_path: Path) -> None:
    """A driver with link and motor encoders in one message, under different names, gives samples of
    both sides."""
    text = "joints:\n" + "".join(
        f"  {j}:\n    link: {{position: {{topic: /js, name: {j}_link}}}}\n"
        f"    motor: {{position: {{topic: /js, name: {j}_motor}}}}\n"
        for j in "ab"
    )
    box = Collector(("a", "b"), channels=driver_map(tmp_path, text))
    names = ["a_link", "a_motor", "b_link", "b_motor"]
    box.inboxes["/js"].put(states(names, 1, position=[1.0, 2.0, 3.0, 4.0]))
    samples = box.take(everything=True)
    assert (samples.q.tolist(), samples.theta.tolist()) == ([[1.0, 3.0]], [[2.0, 4.0]])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (("b: {name: axis_2, motor: {effort: {sign: -1}}}", ""), "lacks b"),
        (("joints:", "time: arrival\njoints:"), "Record a bag"),
        (("effort: {topic: /arm/joint_states", "effort: {topic: /arm/currents"), "one topic"),
    ],
)
def test_a_map_that_a_live_graph_cannot_serve_is_refused(
    tmp_path: Path, changed: tuple[str, str], said: str
) -> None:
    """What only a bag can be read by is refused at the start, with what to do."""
    with pytest.raises(RecordingError, match=said):
        Collector(("a", "b"), channels=driver_map(tmp_path, DRIVER.replace(*changed)))


def test_messages_that_cannot_be_used_are_counted_and_told() -> None:
    """Other joints, numbers that are not finite and changed fields are left out, each said in
    words."""
    box = collector("motor")
    inbox = box.inboxes["/motor_states"]
    inbox.put(states(["a", "b"], 1, position=[1.0, 2.0]))
    inbox.put(states(["x", "y"], 2, position=[1.0, 2.0]))
    inbox.put(states(["a", "b"], 3, position=[1.0, float("nan")]))
    inbox.put(states(["a", "b"], 4, position=[1.0, 2.0], velocity=[1.0, 2.0]))
    samples = box.take(everything=True)
    assert len(samples) == 1
    assert (box.faults.foreign, box.faults.not_finite, box.faults.changed) == (1, 1, 1)
    assert len([words for words in box.problems() if words.startswith("1 ")]) == 3


def test_one_side_alone_makes_samples() -> None:
    """An arm that has only a motor side gives samples without waiting for the other."""
    box = collector("motor")
    for stamp in (1, 2, 3):
        box.inboxes["/motor_states"].put(
            states(["a", "b"], stamp, position=[1.0, 2.0], effort=[3.0, 4.0])
        )
    samples = box.take(everything=True)
    assert samples.t.tolist() == pytest.approx([0.0, 0.001, 0.002])
    assert samples.q is None
    assert samples.tau_J is None


# The plan of a motion


def test_the_way_to_the_start_is_smooth_and_within_its_speed() -> None:
    """From rest where the arm stands to the trajectory's start there is no jump, and no more than
    the speed given."""
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 2, 3)) * 0.2
    trajectory = FourierTrajectory(2.0, a, b, np.array([1.0, -0.5]), 4.0, 0.5)
    plan = Plan(trajectory, np.array([0.3, 0.2]), speed=0.3)
    t = np.arange(0.0, plan.duration, 0.001)
    rows = plan.evaluate(t)
    np.testing.assert_allclose(rows.position[0], [0.3, 0.2], atol=1e-12)
    approach = t < plan.approach
    assert np.abs(rows.velocity[approach]).max() <= 0.3 + 1e-9
    for values, rate in ((rows.position, rows.velocity), (rows.velocity, rows.acceleration)):
        means = (rate[1:] + rate[:-1]) / 2
        np.testing.assert_allclose(np.diff(values, axis=0) / 0.001, means, atol=2e-3)
    q, dq, _ = trajectory.evaluate(t[~approach] - plan.approach)
    np.testing.assert_allclose(rows.position[~approach], q)
    np.testing.assert_allclose(rows.velocity[~approach], dq)


def test_a_plan_can_be_repeated() -> None:
    """Each round is the same motion, and the last point is at rest."""
    trajectory = FourierTrajectory(
        2.0, np.full((1, 1), 0.3), np.zeros((1, 1)), np.zeros(1), 4.0, 0.5
    )
    plan = Plan(trajectory, np.zeros(1), repeat=3)
    assert plan.duration == pytest.approx(12.0)
    t = np.linspace(0.1, 3.9, 20)
    np.testing.assert_allclose(
        plan.evaluate(t + 8.0).position, plan.evaluate(t).position, atol=1e-12
    )
    assert not plan.evaluate(np.array([plan.duration])).velocity.any()
    assert np.isinf(Plan(trajectory, np.zeros(1), repeat=0).duration)


# The process


def test_a_name_that_is_no_text_is_refused_before_ros_sees_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """ROS takes UTF-8 alone; a folder may be called anything."""
    assert (
        run(
            lambda: pytest.fail("a node was made"), ["replayer", "--ros-args", "-p", "bag:=x\udcff"]
        )
        == 2
    )
    said = capsys.readouterr().err
    assert (
        said.startswith("error: 'bag:=x")
        and "is not valid UTF-8" in said
        and len(said.splitlines()) == 1
    )


@pytest.mark.parametrize("words", [["-p", "bag:=["], ["-p", "bag"], ["-r", "x"], ["--nothing"]])
def test_arguments_that_ros_does_not_take_are_refused_in_a_line(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """It names the argument, and there is no traceback of the library's."""
    assert run(lambda: pytest.fail("a node was made"), ["replayer", "--ros-args", *words]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert words[-1] in line


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-p", "topics:=['no topic!']"], "'no topic!' is not a name of a topic"),
        (["-p", "bag:=" + "n" * 300], "File name too long"),
    ],
)
def test_a_recorder_refuses_names_that_cannot_be_in_a_line(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Names of topics that ROS has not, and of folders that no disk takes, are no tracebacks."""
    monkeypatch.chdir(tmp_path)
    assert run(Recorder, ["recorder", "--ros-args", *words]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert said in line


def test_a_node_whose_tick_fails_knows_so_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The recorder reports no bag as whole that a full disk has cut off."""
    executor = SimpleNamespace(add_node=id, remove_node=id, shutdown=list, spin_once=id)
    monkeypatch.setattr(running, "EventsExecutor", lambda: executor)
    known: list[ElasticArmError | None] = []
    full = RecordingError("the disk is full", "Free space.")

    class Node:
        failure: ElasticArmError | None = None

        def tick(self) -> float:
            raise full

        def done(self) -> bool:
            return False

        def close(self) -> None:
            known.append(self.failure)

        def destroy_node(self) -> None:
            pass

    make: Any = Node
    with pytest.raises(RecordingError):
        running._spin(make, cast("running._Stop", SimpleNamespace(asked=False)))
    assert known == [full]


# Playing back


def playback() -> Playback:
    """Ten messages a second apart, from 100 s on."""
    return Playback(
        iter([Message((100 + k) * 1000 * MS, 0, "/a", "", bytes([k])) for k in range(10)])
    )


def test_messages_are_due_in_the_rhythm_of_their_recording() -> None:
    """The first is due at once, the next a second later, or half a second at twice the speed."""
    bag = playback()
    assert bag.wait(5.0, 1.0) == 0.0
    assert bag.take().data == b"\x00"
    assert bag.wait(5.25, 1.0) == pytest.approx(0.75)
    assert bag.wait(5.25, 2.0) == pytest.approx(0.375)
    assert bag.wait(5.625, 2.0) == pytest.approx(0.0)


@pytest.mark.parametrize(
    "type_name", ["control_msgs/msg/JointTolerance", "trajectory_msgs/msg/JointTrajectory"]
)
def test_the_definition_of_an_installed_type_holds_all_that_it_is_made_of(type_name: str) -> None:
    """The text made of the installed files parses, and is what the library has for a type that it
    knows."""
    text, type_hash = installed_definition(type_name)
    assert type_hash.startswith("RIHS01_")
    fields = parse_definition(type_name, "ros2msg", text)
    assert type_name in fields
    if message_types.known(type_name):
        assert type_hash == message_types.definition(type_name)[1]
        known = message_types.typestore().fielddefs
        assert all(fields[name][1] == known[name][1] for name in fields)


def test_a_type_that_is_not_installed_has_no_definition() -> None:
    """Its messages are recorded all the same."""
    assert installed_definition("nowhere_msgs/msg/Nothing") == ("", "")
