"""What an arm may do: kinematic limits, torque, and links that keep clear of the floor and of each
other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_arm.dynamics import build_model
from elastic_arm.errors import ExcitationError
from elastic_arm.excitation import MARGIN, FourierTrajectory, MotionLimits, Workspace
from elastic_arm.excitation.workspace import _distances
from tests.helpers.motions import planar_arm, trajectory


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.1, 20.0))
def test_a_fitted_motion_keeps_the_kinematic_limits(seed: int, size: float) -> None:
    """Whatever its amplitudes, a fitted motion keeps position, velocity and acceleration limits at
    dense times."""
    n = 3
    limits = MotionLimits(
        ("a", "b", "c"),
        np.full(n, -2.0),
        np.array([1.0, 2.0, 3.0]),
        np.full(n, 1.2),
        np.full(n, 4.0),
        np.full(n, 1.0),
    )
    drawn = trajectory(seed)
    motion = limits.fitted(
        FourierTrajectory(**{**vars(drawn), "q0": np.clip(drawn.q0, -1.8, 0.9)}).scaled(size), 0.98
    )
    q, dq, ddq = motion.evaluate(np.linspace(0, motion.duration, 20_000))
    assert (q >= limits.position_min).all()
    assert (q <= limits.position_max).all()
    assert (np.abs(dq) <= limits.velocity).all()
    assert (np.abs(ddq) <= limits.acceleration).all()


def test_stated_limits_hold_and_missing_ones_are_said() -> None:
    """The description's limits count; where it has none, a default does, and a sentence says so."""
    limits = MotionLimits.of(planar_arm(2, velocity=0.7), torque=5.0)
    np.testing.assert_array_equal(limits.velocity, 0.7)
    np.testing.assert_array_equal(limits.torque, 5.0)
    said = " ".join(limits.assumed)
    assert "acceleration of j0, j1" in said
    assert "velocity" not in said
    given = MotionLimits.of(planar_arm(2, velocity=0.7), velocity=2.0, acceleration=20.0)
    np.testing.assert_array_equal(given.velocity, 0.7)
    np.testing.assert_array_equal(given.acceleration, 20.0)
    assert "acceleration" not in " ".join(given.assumed)
    with pytest.raises(ExcitationError, match="velocity limit is -1"):
        MotionLimits.of(planar_arm(2), velocity=-1.0)


def test_use_of_torque_is_that_of_the_rigid_arm() -> None:
    """A pendulum held level uses m g l of torque."""
    robot = planar_arm(1, torque=10.0)
    still = FourierTrajectory.of_periods(
        4.0, np.zeros((1, 1)), np.zeros((1, 1)), np.array([np.pi / 2]), ramp=1.0
    )
    use = MotionLimits.of(robot).use(still, build_model(robot, engine="numpy"))
    assert use.peak_torque[0] == pytest.approx(9.81 * 0.25)
    assert use.torque[0] == pytest.approx(0.2453, rel=1e-3)


def test_a_link_in_the_floor_is_found() -> None:
    """An upright arm is clear of the floor; hanging down, it goes through by as much as geometry
    says."""
    workspace = Workspace.of(planar_arm(3), radius=0.05)
    floor, _ = workspace.clearance(np.array([[0.0, 0.0, 0.0], [np.pi, 0.0, 0.0]]))
    assert floor[0] == pytest.approx(1.5 - 0.05)
    assert floor[1] == pytest.approx(1.0 - 1.5 - 0.05)
    without, _ = Workspace.of(planar_arm(3), floor=None).clearance(np.zeros((1, 3)))
    assert np.isinf(without).all()


def test_a_link_in_another_link_is_found() -> None:
    """Folded to a triangle, the third link meets the first; stretched, they are a link apart."""
    workspace = Workspace.of(planar_arm(3), radius=0.05, floor=None)
    third = 2.0 * np.pi / 3.0
    _, links = workspace.clearance(np.array([[0.0, third, third], [0.0, 0.0, 0.0]]))
    assert links[0] == pytest.approx(-0.1, abs=1e-9)
    assert links[1] == pytest.approx(0.5 - 0.1)


def _hold(*angles: float) -> FourierTrajectory:
    none = np.zeros((len(angles), 1))
    return FourierTrajectory.of_periods(4.0, none, none, np.array(angles), ramp=1.0)


def test_links_keep_a_margin_to_the_floor() -> None:
    """A link 10 mm above the floor breaks the default margin of 20 mm, and keeps one of 5 mm."""
    robot = planar_arm(1)
    model = build_model(robot, engine="numpy")
    low = Workspace.of(robot, radius=0.05, floor=0.44)  # the arm's end hangs at 0.5 m
    default = MotionLimits.of(robot, workspace=low)
    assert default.margin == MARGIN == 0.02
    use = default.use(_hold(np.pi), model)
    assert (
        not use.kept and "a link is within 10.0 mm of the floor; the margin is 20 mm" in use.worst()
    )
    close = MotionLimits.of(robot, workspace=low, margin=0.005)
    assert close.use(_hold(np.pi), model).floor == pytest.approx(0.01)


def test_links_keep_a_margin_to_each_other() -> None:
    """Two links 10 mm apart break the default margin and keep one of 5 mm; the result says gap and
    margin."""
    robot = planar_arm(3)
    model = build_model(robot, engine="numpy")
    third = 2.0 * np.pi / 3.0
    opened = _hold(0.0, third, third - 0.24)
    gap = (
        MotionLimits.of(robot, workspace=Workspace.of(robot, radius=1e-6, floor=None))
        .use(opened, model)
        .links
    )
    near = Workspace.of(robot, radius=0.5 * (gap - 0.01), floor=None)
    assert not MotionLimits.of(robot, workspace=near).use(opened, model).kept
    use = MotionLimits.of(robot, workspace=near, margin=0.005).use(opened, model)
    told = use.to_dict()
    assert (told["links_gap_m"], told["margin_m"]) == (pytest.approx(0.01, abs=1e-5), 0.005)


@pytest.mark.parametrize("margin", [-0.01, float("nan"), float("inf")])
def test_a_margin_that_is_no_length_is_refused(margin: float) -> None:
    """Negative, infinite and undefined margins raise an error that names the margin."""
    with pytest.raises(ExcitationError, match="the safety margin is"):
        MotionLimits.of(planar_arm(1), margin=margin)


def test_links_that_always_touch_do_not_count() -> None:
    """Two links around one shorter than they are thick never make a motion forbidden."""
    workspace = Workspace.of(planar_arm(3), radius=0.3, floor=None)
    assert (1, 3) not in {tuple(pair) for pair in workspace.pairs.tolist()}


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), flat=st.booleans(), point=st.booleans())
def test_segment_distance_is_the_least_over_both_segments(
    seed: int, flat: bool, point: bool
) -> None:
    """The distance is not above, and nearly, the least of a fine grid; parallel segments and points
    included."""
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(4, 3))
    if flat:
        p[3] = p[2] + rng.normal() * (p[1] - p[0])
    if point:
        p[1] = p[0]
    # Segment 1 of the chain p0 p1 p2 p3 joins the two that are compared.
    found = _distances(p[None], np.array([[0, 2]]))[0, 0]
    s = np.linspace(0, 1, 201)
    first = p[0] + s[:, None] * (p[1] - p[0])
    second = p[2] + s[:, None] * (p[3] - p[2])
    grid = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    spacing = (np.linalg.norm(p[1] - p[0]) + np.linalg.norm(p[3] - p[2])) / 400
    assert grid - spacing - 1e-9 <= found <= grid + 1e-9
