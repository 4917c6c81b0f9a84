"""Goals of few points: interpolated from the present state, kept within limits, or refused in
words."""

from dataclasses import replace

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from scipy.interpolate import BPoly
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from elastic_arm.errors import GraphError
from elastic_arm.nodes.following.follower import Follower
from elastic_arm.nodes.following.reference_message import commanded
from elastic_arm.nodes.following.splines import Row
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.parts import Limits

MS = 1_000_000
ARM = load_robot()
NAMES = ARM.joint_names


def point(seconds: float, position: list[float], **rest: list[float]) -> JointTrajectoryPoint:
    whole, part = divmod(round(seconds * 1e9), 10**9)
    return JointTrajectoryPoint(
        positions=position, time_from_start=Duration(sec=whole, nanosec=part), **rest
    )


def goal(
    *points: JointTrajectoryPoint, names: tuple[str, ...] = NAMES, stamp_ns: int = 0
) -> JointTrajectory:
    message = JointTrajectory(joint_names=list(names), points=list(points))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


def follower(robot: Robot = ARM, policy: str = "refuse") -> Follower:
    made = Follower(robot, np.zeros(3), 0, MS, policy)
    made.at(1)
    return made


def gone(follower: Follower, seconds: float) -> Row:
    """Return the reference of the coming seconds, (N, n) each."""
    first = follower.now_ns // MS + 1
    rows = [follower.at(step) for step in range(first, first + round(seconds * 1000))]
    return Row(*(np.array(values) for values in zip(*rows, strict=True)))


def test_a_position_alone_is_gone_to_in_a_straight_line_from_where_the_arm_is() -> None:
    """0.5 rad in 2 s is 0.25 rad/s all the way, and rest behind it; not a step."""
    arm = follower()
    arm.take(goal(point(2.0, [0.5, -0.5, 0.2])))
    motion = gone(arm, 3.0)
    np.testing.assert_allclose(motion.position[:2000, 0], 0.25e-3 * np.arange(1, 2001), atol=1e-12)
    np.testing.assert_allclose(motion.velocity[:1999, 0], 0.25, atol=1e-9)
    np.testing.assert_array_equal(motion.position[2000:], np.tile([0.5, -0.5, 0.2], (1000, 1)))
    assert not motion.velocity[1999:].any()


@pytest.mark.parametrize("degree", [3, 5])
def test_what_a_point_holds_decides_on_cubic_or_quintic(degree: int) -> None:
    """Points with velocities are joined by the cubic, with accelerations by the quintic, as SciPy's
    Hermite ones."""
    given = np.random.default_rng(degree).uniform(-0.3, 0.3, (2, 3, 3))
    given[1, 1:] = 0.0
    fields = ("velocities", "accelerations")[: (degree - 1) // 2]
    arm = follower(policy="ignore")
    points = [
        point(
            2.0 * (k + 1),
            list(values[0]),
            **{f: list(v) for f, v in zip(fields, values[1:], strict=False)},
        )
        for k, values in enumerate(given)
    ]
    arm.take(goal(*points))
    motion = gone(arm, 4.0)
    knots = np.concatenate((np.zeros((1, 3, 3)), given))[:, : 1 + len(fields)]
    spline = BPoly.from_derivatives([0.0, 2.0, 4.0], list(knots))
    t = np.arange(1, 4000) * 1e-3
    for k, values in enumerate(motion):
        np.testing.assert_allclose(values[:-1], spline.derivative(k)(t), atol=1e-9)


def test_a_new_goal_goes_on_from_the_motion_that_it_replaces() -> None:
    """In the middle of a motion, a goal with velocities is joined without a jump of position or
    velocity."""
    arm = follower()
    arm.take(goal(point(2.0, [0.5, 0.5, 0.5], velocities=[0.0, 0.0, 0.0])))
    before = gone(arm, 1.0)
    arm.take(goal(point(3.0, [-0.2, 0.0, 0.1], velocities=[0.0, 0.0, 0.0])))
    after = gone(arm, 3.0)
    motion = np.concatenate((before.position, after.position))
    assert before.velocity[-1, 0] == pytest.approx(0.375)
    assert np.abs(np.diff(motion, 2, axis=0)).max() * 1e6 < 6.0
    np.testing.assert_allclose(motion[-1], [-0.2, 0.0, 0.1], atol=1e-12)


def test_joints_that_a_goal_does_not_name_stay() -> None:
    """A goal for one joint moves that joint alone."""
    arm = follower()
    arm.take(goal(point(1.0, [0.3]), names=NAMES[1:2]))
    np.testing.assert_allclose(gone(arm, 1.5).position[-1], [0.0, 0.3, 0.0])


def test_points_that_have_passed_are_left_out() -> None:
    """Of a goal that arrives late, the arm goes to the points that are still to come."""
    arm = follower()
    gone(arm, 1.0)
    arm.take(goal(point(0.5, [9.0, 9.0, 9.0]), point(2.0, [0.3, 0.3, 0.3]), stamp_ns=1))
    assert gone(arm, 1.0).position[-1] == pytest.approx(0.3, abs=1e-6)


def limited(**limits: float) -> Robot:
    joint = ARM.joints[1]
    return ARM.with_joint(joint.name, limits=replace(Limits(), **limits))


BROKEN = {
    "position": (
        ARM,
        point(60.0, [0.0, 4.0, 0.0]),
        "joint_2 to a position of 4 rad, beyond the limit of 3.14 rad",
    ),
    "velocity": (
        ARM,
        point(0.1, [0.5, 0.0, 0.0]),
        "joint_1 to a velocity of 5 rad/s, beyond the limit of 1.5 rad/s",
    ),
    "a stated limit": (
        limited(velocity=0.2),
        point(2.0, [0.5, 0.5, 0.5]),
        "joint_2 to a velocity of 0.25 rad/s",
    ),
    "acceleration": (
        limited(acceleration=0.5),
        point(1.0, [0.0, 0.5, 0.0], velocities=[0.0, 0.0, 0.0]),
        "joint_2 to an acceleration of 3 rad/s²",
    ),
    "ends with a nonzero velocity": (
        ARM,
        point(1.0, [0.1, 0.1, 0.1], velocities=[0.5, 0.0, 0.0]),
        "ends with a nonzero velocity",
    ),
    "no time": (ARM, point(0.0, [0.1, 0.1, 0.1]), "is in the past"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_goal_that_breaks_a_limit_is_refused_in_words(what: str) -> None:
    """The error names joint, value and limit; the arm stands where it was."""
    robot, sent, words = BROKEN[what]
    arm = follower(robot)
    with pytest.raises(GraphError, match=words):
        arm.take(goal(sent))
    assert not gone(arm, 0.1).position.any()


@pytest.mark.parametrize(
    "given", [{}, {"velocities": [0.0] * 3}, {"velocities": [0.0] * 3, "accelerations": [0.0] * 3}]
)
def test_a_goal_is_slowed_down_to_the_limits_where_that_is_wanted(
    given: dict[str, list[float]],
) -> None:
    """With `slow_down` the motion takes the time that the limits need, and ends where it was to
    end."""
    robot = limited(velocity=0.3, acceleration=0.5)
    arm = follower(robot, "slow_down")
    made = arm.take(goal(point(0.1, [0.0, 0.5, 0.0], **given)))
    assert made.slower > 10
    motion = gone(arm, 0.1 * made.slower + 0.1)
    assert np.abs(motion.velocity[:, 1]).max() <= 0.3 * 1.03
    assert np.abs(motion.acceleration[:, 1]).max() <= 0.5 * 1.03
    assert motion.position[-1, 1] == pytest.approx(0.5)
    with pytest.raises(GraphError, match="at any speed"):
        arm.take(goal(point(0.1, [0.0, 4.0, 0.0], **given)))


def test_a_stop_brings_the_arm_to_rest_without_a_jump() -> None:
    """From 0.75 rad/s the arm slows down evenly and stands."""
    arm = follower()
    arm.take(goal(point(1.0, [0.5, 0.0, 0.0], velocities=[0.0, 0.0, 0.0])))
    before = gone(arm, 0.5)
    arm.stop()
    after = gone(arm, 0.5)
    assert before.velocity[-1, 0] == pytest.approx(0.75)
    assert (
        np.abs(np.diff(np.concatenate((before.velocity, after.velocity)), axis=0)).max() * 1e3 < 6.1
    )
    assert not after.velocity[-1].any()


def streamed(begin_ns: int, position: np.ndarray, velocity: float) -> JointTrajectory:
    return goal(
        *(point(1e-3 * k, list(row), velocities=[velocity] * 3) for k, row in enumerate(position)),
        stamp_ns=begin_ns,
    )


def test_a_stream_that_begins_elsewhere_is_refused() -> None:
    """Streamed points a quarter of a radian from the arm would be a jump; those where it is are
    followed."""
    arm = follower()
    with pytest.raises(GraphError, match=r"starts 0\.25 rad from the position of joint_1"):
        arm.take(streamed(MS, np.full((20, 3), 0.25), 0.0))
    ramp = 1e-4 * np.arange(400)[:, None] * np.ones(3)
    assert arm.take(streamed(2 * MS, ramp, 0.1)) is None
    np.testing.assert_allclose(gone(arm, 0.1).position, ramp[:100], atol=1e-15)


def test_a_stream_keeps_the_limits_that_the_arm_states() -> None:
    """Limits of the arm file hold for streams too; what it does not state is not assumed."""
    ramp = 5e-3 * np.arange(20)[:, None] * np.ones(3)
    assert follower().take(streamed(2 * MS, ramp, 5.0)) is None
    with pytest.raises(GraphError, match="joint_2 to a velocity of 5 rad/s"):
        follower(limited(velocity=1.0)).take(streamed(2 * MS, ramp, 5.0))


def test_positions_alone_may_be_streamed() -> None:
    """A stream of positions moves at the slope between them, also across the messages' borders."""
    arm = follower()
    ramp = 1e-4 * np.arange(60)[:, None] * np.ones(3)
    for begin in range(0, 60, 20):
        message = streamed((begin + 2) * MS, ramp[begin : begin + 20], 0.0)
        for sent in message.points:
            sent.velocities = []
        arm.take(message)
    motion = gone(arm, 0.058)
    np.testing.assert_allclose(motion.position, ramp[:58], atol=1e-15)
    np.testing.assert_allclose(motion.velocity, 0.1, atol=1e-9)


NOW_S = 1_700_000_000
LAST = (2**31 - 1) * 10**9
ZEROS = [0.0, 0.0, 0.0]
FAR = [1e3, 0.0, 0.0]
ABSURD_STREAMS = {
    "of 68 years": (
        NOW_S * 10**9,
        [point(0.0, ZEROS), point(2.0**31 - 1, ZEROS)],
        "streams points over 2.15e.09 s",
    ),
    "of three hours": (
        NOW_S * 10**9,
        [point(0.0, ZEROS), point(10800.0, ZEROS)],
        "streams points over 1.08e.04 s",
    ),
    "from 1970 to now": (
        10**9,
        [point(0.0, ZEROS), point(NOW_S, ZEROS)],
        "streams points over 1.7e.09 s",
    ),
    "in 2038": (LAST, [point(0.0, ZEROS)], "due 4.47e.08 s from now"),
    "faster than any arm": (
        NOW_S * 10**9,
        [point(0.0, ZEROS), point(1.0, FAR)],
        "velocity of 1e.03 rad/s",
    ),
    "fast between points at rest": (
        NOW_S * 10**9,
        [point(0.0, ZEROS, velocities=ZEROS), point(1.0, FAR, velocities=ZEROS)],
        "velocity of 1e.03 rad/s",
    ),
    "of huge numbers": (
        NOW_S * 10**9,
        [point(0.0, ZEROS), point(1.0, [1e308, 0.0, 0.0])],
        "a value of 1e.308",
    ),
}


def in_our_time(policy: str = "refuse") -> Follower:
    """Return a follower whose clock stands in our days, as a simulator's in real time does."""
    made = Follower(ARM, np.zeros(3), NOW_S * 10**9, MS, policy)
    made.at(1)
    return made


@pytest.mark.parametrize("what", ABSURD_STREAMS)
@pytest.mark.parametrize("policy", ["refuse", "ignore"])
@pytest.mark.filterwarnings("error")
def test_an_absurd_stream_is_refused_before_memory_is_taken(what: str, policy: str) -> None:
    """Rows are made for every step of a stream: one message must not ask for years of them."""
    stamp, points, words = ABSURD_STREAMS[what]
    arm = in_our_time(policy)
    if policy == "refuse" or "fast" not in what:
        with pytest.raises(GraphError, match=words):
            arm.take(goal(*points, stamp_ns=stamp))
    assert not gone(arm, 0.1).velocity.any()


@pytest.mark.parametrize("policy", ["refuse", "ignore"])
@pytest.mark.filterwarnings("error")
def test_a_stream_of_too_many_points_is_refused(policy: str) -> None:
    """The points of one message are limited, as are its rows."""
    points = [point(1e-3 * k, ZEROS) for k in range(20_001)]
    arm = in_our_time(policy)
    with pytest.raises(GraphError, match="contains 20001 points"):
        arm.take(goal(*points, stamp_ns=NOW_S * 10**9))
    assert not gone(arm, 0.1).velocity.any()


def test_a_stream_of_old_stamps_leaves_nothing_behind() -> None:
    """What is of another clock is forgotten, also where it lies half a century back or before
    any."""
    for stamp in (10**9, -(10**18)):
        arm = in_our_time()
        arm.take(goal(point(0.0, ZEROS), point(100.0, ZEROS), stamp_ns=stamp))
        assert not gone(arm, 0.1).velocity.any()
        assert not arm.stream._motions


def test_a_stream_that_leaps_from_its_last_point_is_refused() -> None:
    """The next message of a stream is looked at from where the one before ended."""
    arm = follower()
    arm.take(goal(point(0.0, ZEROS), point(0.1, ZEROS), stamp_ns=100 * MS))
    with pytest.raises(GraphError, match=r"moves .* to a velocity of 1e.06 rad/s"):
        arm.take(goal(point(0.0, FAR), point(0.1, FAR), stamp_ns=201 * MS))


@pytest.mark.parametrize("policy", ["refuse", "slow_down", "ignore"])
@pytest.mark.filterwarnings("error")
def test_a_goal_in_weeks_is_refused(policy: str) -> None:
    """A stretched one would leave 64 bits of nanoseconds."""
    arm = in_our_time(policy)
    fast = point(1.0, ZEROS, velocities=[1e6, 0.0, 0.0])
    for sent in (goal(fast, point(2.0**31 - 1, ZEROS)), goal(point(1.0, ZEROS), stamp_ns=LAST)):
        with pytest.raises(GraphError, match=r"is due .* s from now"):
            arm.take(sent)


@pytest.mark.parametrize(("with_velocity", "lag"), [(True, 1e-3), (False, 0.02)])
def test_commands_of_a_controller_are_followed(with_velocity: bool, lag: float) -> None:
    """A sine of 0.3 rad/s, commanded every 10 ms: within the lag, s, times its speed."""
    arm = follower()
    course = []
    for k in range(200):
        t = 0.01 * k
        command = JointState(name=list(NAMES), position=[0.15 * np.sin(2.0 * t)] * 3)
        if with_velocity:
            command.velocity = [0.3 * np.cos(2.0 * t)] * 3
        arm.obey(commanded(command, 0.02))
        course.append(gone(arm, 0.01).position[:, 0])
    t = 1e-3 * np.arange(1, 2001)
    apart = np.abs(np.concatenate(course) - 0.15 * np.sin(2.0 * t))[100:]
    assert apart.max() < 0.3 * lag


def test_a_command_out_of_reach_is_gone_to_within_the_limits() -> None:
    """A step of 1 rad in one cycle is a way at the speed limit, 1.5 rad/s where none is stated."""
    arm = follower()
    arm.obey(commanded(JointState(name=list(NAMES), position=[1.0, 0.0, 0.0]), 0.02))
    motion = gone(arm, 1.0)
    assert np.abs(motion.velocity).max() == pytest.approx(1.5, rel=0.01)
    assert motion.position[-1, 0] == pytest.approx(1.0)


def test_a_command_that_no_controller_gives_moves_nothing() -> None:
    """Before a controller is active, ros2_control's topic-based system sends no numbers."""
    assert commanded(JointState(name=list(NAMES), position=[np.nan] * 3), 0.02) is None
    assert commanded(JointState(name=list(NAMES)), 0.02) is None
