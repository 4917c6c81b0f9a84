"""Excitation: smooth Fourier motion, limits that hold, criteria, and a search that improves on chance."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from elastic_arm.cli.describe import describe
from elastic_arm.cli.excite import excite
from elastic_arm.dynamics import Model, build_model
from elastic_arm.errors import ExcitationError
from elastic_arm.excitation import (
    CRITERIA,
    BaseRegressor,
    ExcitationResult,
    FourierTrajectory,
    MotionLimits,
    Shape,
    Workspace,
    check_limits,
    load_trajectory,
    optimise,
    random_trajectories,
)
from elastic_arm.excitation.criteria import distinct_columns, elastic_motion
from elastic_arm.excitation.workspace import _distances
from elastic_arm.identification.equations import Equations
from elastic_arm.report import excitation as figures
from elastic_arm.robot import Inertia, Joint, Limits, Robot, load_robot
from elastic_arm.robot.synthetic import random_arm


def trajectory(seed: int = 0, n: int = 3, harmonics: int = 4, **changes: float) -> FourierTrajectory:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, n, harmonics))
    settings_ = {"period": 7.0, "periods": 2, "ramp": 1.5, **changes}
    return FourierTrajectory.of_periods(a=a, b=b, q0=rng.normal(size=n), **settings_)


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot()


@pytest.fixture(scope="module")
def mod3(arm: Robot) -> Model:
    return build_model(arm, "mod3")


@pytest.fixture(scope="module")
def columns(mod3: Model) -> np.ndarray:
    return Equations(mod3, ("q", "theta", "tau_m")).base.columns


@pytest.fixture(scope="module")
def limits(arm: Robot) -> MotionLimits:
    return MotionLimits.of(arm)


def planar_arm(links: int, **limits: float) -> Robot:
    """Links of 0.5 m that swing in the vertical plane from 1 m above the floor, straight up at q = 0."""
    body = Inertia(1.0, np.array([-0.25, 0.0, 0.0]), np.diag([1e-3, 1e-2, 1e-2]))
    first, after = np.eye(4), np.eye(4)
    first[:3, :3] = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
    after[0, 3] = 0.5
    base = np.eye(4)
    base[2, 3] = 1.0
    joints = [
        Joint(f"j{i}", f"l{i}", body, first if i == 0 else np.eye(4), after, limits=Limits(**limits))
        for i in range(links)
    ]
    return Robot("planar", tuple(joints), base_placement=base)


# --- the motion


def test_velocity_and_acceleration_are_the_derivatives_of_position() -> None:
    """dq and ddq agree with fourth-order differences of q all along, ramps included."""
    motion, h = trajectory(), 1e-3
    t = np.linspace(0.01, motion.duration - 0.01, 900)
    _, dq, ddq = motion.evaluate(t)
    far, near = ([motion.evaluate(t + s * k * h) for s in (-1, 1)] for k in (2, 1))
    for order, derivative in enumerate((dq, ddq)):
        steps = [far[0][order] - far[1][order], near[1][order] - near[0][order]]
        np.testing.assert_allclose((steps[0] + 8 * steps[1]) / (12 * h), derivative, atol=1e-7)


def test_the_motion_starts_and_stops_at_rest_without_a_jump() -> None:
    """At both ends q = q0, dq = ddq = 0, and the acceleration leaves zero more slowly than the square of time."""
    motion = trajectory()
    ends = np.array([0.0, motion.duration])
    for values, expected in zip(motion.evaluate(ends), (motion.q0, 0.0, 0.0), strict=True):
        np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape), atol=1e-12)
    early = np.abs(motion.evaluate(np.array([1e-3, 2e-3]))[2]).max(axis=1)
    assert early[1] / early[0] == pytest.approx(2.0**3, rel=0.05)


def test_between_the_ramps_the_motion_is_exactly_periodic() -> None:
    """Over the periodic section, q, dq and ddq repeat after one period."""
    motion = trajectory(periods=3)
    start, stop = motion.periodic
    t = np.linspace(start, stop - motion.period, 50)
    for now, later in zip(motion.evaluate(t), motion.evaluate(t + motion.period), strict=True):
        np.testing.assert_allclose(later, now, atol=1e-12)
    assert (stop - start) / motion.period == pytest.approx(3)


def test_outside_its_time_the_arm_rests_at_q0() -> None:
    """Before the beginning and after the end the motion holds q0."""
    motion = trajectory()
    q, dq, _ = motion.evaluate(np.array([-1.0, motion.duration + 1.0]))
    np.testing.assert_allclose(q, [motion.q0] * 2, atol=1e-12)
    assert not dq.any()


def test_a_saved_trajectory_loads_to_the_same_motion(tmp_path: Path) -> None:
    """The YAML file keeps every digit."""
    motion = trajectory()
    motion.save(tmp_path / "new folder" / "t.yaml")
    again = load_trajectory(tmp_path / "new folder" / "t.yaml")
    t = np.linspace(0, motion.duration, 40)
    for one, other in zip(motion.evaluate(t), again.evaluate(t), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("a", [[], [], []], "no harmonics"),
        ("a", [[1.0, 2.0]], "a is (1, 2)"),
        ("q0", [0.0, "x", 0.0], "q0 is not made of numbers"),
        ("b", [[float("nan")] * 4] * 3, "b holds a number that is not finite"),
        ("omega", 0.0, "omega is 0"),
        ("ramp", -1.0, "ramp is -1"),
        ("ramp", 50.0, "leaves no time"),
        ("joints", ["one"], "1 joint names"),
        ("speed", 3, "unknown field speed"),
        ("omega", None, "misses omega"),
        ("schema", "other", "is no trajectory file"),
    ],
)
def test_a_wrong_trajectory_file_is_refused_by_field(tmp_path: Path, field: str, value: object, problem: str) -> None:
    """A file that holds no motion raises an error with its path and the field."""
    path = tmp_path / "t.yaml"
    trajectory().save(path)
    content = yaml.safe_load(path.read_text())
    if value is None:
        del content[field]
    else:
        content[field] = value
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ExcitationError) as caught:
        load_trajectory(path)
    assert str(path) in str(caught.value)
    assert problem in str(caught.value)


def test_a_missing_or_broken_file_is_said(tmp_path: Path) -> None:
    """No file and no YAML are told apart."""
    with pytest.raises(ExcitationError, match="no such file"):
        load_trajectory(tmp_path / "none.yaml")
    (tmp_path / "bad.yaml").write_text("a: [1, 2")
    with pytest.raises(ExcitationError, match="cannot be read as YAML"):
        load_trajectory(tmp_path / "bad.yaml")


# --- limits and workspace


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.1, 20.0))
def test_a_fitted_motion_keeps_the_kinematic_limits(seed: int, size: float) -> None:
    """Whatever its amplitudes, a fitted motion keeps position, velocity and acceleration limits at dense times."""
    n = 3
    limits = MotionLimits(
        ("a", "b", "c"), np.full(n, -2.0), np.array([1.0, 2.0, 3.0]), np.full(n, 1.2), np.full(n, 4.0), np.full(n, 1.0)
    )
    drawn = trajectory(seed)
    motion = limits.fitted(FourierTrajectory(**{**vars(drawn), "q0": np.clip(drawn.q0, -1.8, 0.9)}).scaled(size), 0.98)
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
    with pytest.raises(ExcitationError, match="velocity limit is -1"):
        MotionLimits.of(planar_arm(2), velocity=-1.0)


def test_use_of_torque_is_that_of_the_rigid_arm() -> None:
    """A pendulum held level uses m g l of torque."""
    robot = planar_arm(1, torque=10.0)
    still = FourierTrajectory.of_periods(4.0, np.zeros((1, 1)), np.zeros((1, 1)), np.array([np.pi / 2]), ramp=1.0)
    use = MotionLimits.of(robot).use(still, build_model(robot, engine="numpy"))
    assert use.peak_torque[0] == pytest.approx(9.81 * 0.25)
    assert use.torque[0] == pytest.approx(0.2453, rel=1e-3)


def test_a_link_in_the_floor_is_found() -> None:
    """An upright arm is clear of the floor; hanging down, it goes through by as much as geometry says."""
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


def test_links_that_always_touch_do_not_count() -> None:
    """Two links around one shorter than they are thick never make a motion forbidden."""
    workspace = Workspace.of(planar_arm(3), radius=0.3, floor=None)
    assert (1, 3) not in {tuple(pair) for pair in workspace.pairs.tolist()}


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), flat=st.booleans(), point=st.booleans())
def test_segment_distance_is_the_least_over_both_segments(seed: int, flat: bool, point: bool) -> None:
    """The distance is not above, and nearly, the least of a fine grid; parallel segments and points included."""
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(4, 3))
    if flat:
        p[3] = p[2] + rng.normal() * (p[1] - p[0])
    if point:
        p[1] = p[0]
    # Segment 1 of the chain p0 p1 p2 p3 joins the two that are compared.
    found = _distances(p[None], np.array([[0, 2]]))[0, 0]
    s = np.linspace(0, 1, 201)
    first, second = p[0] + s[:, None] * (p[1] - p[0]), p[2] + s[:, None] * (p[3] - p[2])
    grid = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    spacing = (np.linalg.norm(p[1] - p[0]) + np.linalg.norm(p[3] - p[2])) / 400
    assert grid - spacing - 1e-9 <= found <= grid + 1e-9


# --- criteria


def test_criteria_of_orthonormal_columns() -> None:
    """Orthonormal columns in their own scale: condition 1, and zero decades of uncertainty."""
    W = np.linalg.qr(np.random.default_rng(0).normal(size=(50, 6)))[0]
    values = {name: criterion(W, np.ones(6)) for name, criterion in CRITERIA.items()}
    assert values == pytest.approx({"condition": 1.0, "d_optimal": 0.0, "a_optimal": 0.0}, abs=1e-12)


def test_criteria_are_what_their_formulas_say() -> None:
    """Each criterion equals its formula by the normal equations, columns in units of `scale`."""
    rng = np.random.default_rng(1)
    W, scale = rng.normal(size=(40, 4)), np.array([1.0, 2.0, 0.5, 3.0])
    N = (W / scale).T @ (W / scale)
    assert CRITERIA["condition"](W, scale) == pytest.approx(np.sqrt(np.linalg.cond(N)))
    assert CRITERIA["d_optimal"](W, scale) == pytest.approx(-np.log10(np.linalg.det(N)) / 8)
    assert CRITERIA["a_optimal"](W, scale) == pytest.approx(0.5 * np.log10(np.trace(np.linalg.inv(N)) / 4))


def test_dependent_columns_are_the_worst_finite_number() -> None:
    """A dependent column gives a condition number beyond 1e14, not infinity or an error."""
    W = np.random.default_rng(2).normal(size=(30, 3))
    W[:, 2] = W[:, 0] - W[:, 1]
    assert 1e14 < CRITERIA["condition"](W, np.ones(3)) < np.inf


def test_noise_divides_the_rows_of_its_equation(mod3: Model, columns: np.ndarray) -> None:
    """Twice the noise in all equations halves the base regressor; in one, its rows alone."""
    motion, noise = trajectory(periods=1), np.ones(6)
    noise[4] = 2.0
    plain, weighted = BaseRegressor(mod3, columns)(motion), BaseRegressor(mod3, columns, noise)(motion)
    ratio = np.ones((150, 6))
    ratio[:, 4] = 0.5
    np.testing.assert_allclose(weighted, plain * ratio.ravel()[:, None])


def test_the_motors_lead_so_that_the_link_side_is_in_balance(mod3: Model, arm: Robot) -> None:
    """In the motion that is judged, K (theta - q) bears the link side's torque to a part in a thousand."""
    motion = trajectory(periods=1)
    x, dx, ddx = elastic_motion(mod3, motion, 200)
    K = np.array([j.transmission.stiffness for j in arm.joints])
    carried = K * (x[:, 3:] - x[:, :3])
    residual = mod3.inverse_dynamics(x, dx, ddx)[:, :3]
    damping = np.array([j.transmission.damping for j in arm.joints]) * (dx[:, 3:] - dx[:, :3])
    assert np.abs(residual + damping).max() < 1e-3 * np.abs(carried).max()


def test_what_only_a_soft_arm_could_tell_apart_is_left_out(mod3: Model, arm: Robot, columns: np.ndarray) -> None:
    """In mod3, S_11 asks for q'' and theta'' to differ, so one of its columns is left out; in mod1 there is none."""
    motions = [trajectory(seed, periods=1).scaled(0.3) for seed in range(5)]
    W = np.concatenate([BaseRegressor(mod3, columns)(motion) for motion in motions])
    dropped = set(range(len(columns))) - set(distinct_columns(W).tolist())
    names = [mod3.parameters[columns[k]].name for k in dropped]
    assert len(names) == 1
    assert names[0].startswith("joint_1.")
    mod1 = build_model(arm, "mod1")
    own = Equations(mod1, ("q", "theta", "tau_m")).base.columns
    W = np.concatenate([BaseRegressor(mod1, own)(motion) for motion in motions])
    assert len(distinct_columns(W)) == len(own)


# --- the search


@pytest.fixture(scope="module")
def found(mod3: Model, limits: MotionLimits, columns: np.ndarray) -> ExcitationResult:
    return optimise(mod3, limits, columns, rng=np.random.default_rng(3), evaluations=400, random=20)


def test_the_search_beats_random_motions(found: ExcitationResult) -> None:
    """After 400 evaluations the condition number is below the best of 20 random motions."""
    assert len(found.random) == 20
    assert found.condition_after < found.condition_before
    assert found.condition_before == pytest.approx(found.random.min())


def test_the_course_of_the_search_only_improves(found: ExcitationResult) -> None:
    """The history falls from evaluation to evaluation and ends at the result."""
    counts, values = np.array(found.history).T
    assert (np.diff(counts) >= 0).all()
    assert (np.diff(values) <= 0).all()
    assert values[-1] == pytest.approx(found.condition_after)
    assert found.evaluations == 400


def test_the_motion_found_keeps_every_limit_between_the_samples_too(
    found: ExcitationResult, mod3: Model, limits: MotionLimits
) -> None:
    """At ten times as many times as the search looks at, every limit is kept."""
    use = limits.use(found.trajectory, mod3, np.linspace(0, found.trajectory.duration, 4000))
    assert (use.excess[:4] <= 0).all()
    # Gaps move by less than the motion between two samples of the search.
    assert min(use.floor, use.links) > -2e-3


def test_the_same_generator_gives_the_same_motion(mod3: Model, limits: MotionLimits, columns: np.ndarray) -> None:
    """The search is a function of its seed, also when searches follow one another in a process."""
    runs = [
        optimise(mod3, limits, columns, rng=np.random.default_rng(seed), evaluations=60, random=3).trajectory
        for seed in (1, 2, 1)
    ]
    np.testing.assert_array_equal(runs[0].a, runs[2].a)
    assert not np.array_equal(runs[0].a, runs[1].a)


@pytest.mark.parametrize("criterion", ["d_optimal", "a_optimal"])
def test_the_other_criteria_improve_too(mod3: Model, limits: MotionLimits, columns: np.ndarray, criterion: str) -> None:
    """Whatever the criterion, its value falls, and every evaluation is told."""
    told: list[int] = []
    result = optimise(
        mod3, limits, columns, rng=np.random.default_rng(4), evaluations=80, random=4, criterion=criterion,
        progress=lambda count, best: told.append(count),
    )  # fmt: skip
    assert result.value_after < result.value_before
    assert told == list(range(1, 81))


def test_an_arm_of_five_rigid_joints_is_excited() -> None:
    """Nothing is made for three joints or for transmissions; the floor is left out, as this arm is drawn at random."""
    robot = random_arm(5, np.random.default_rng(8), elastic=False)
    model = build_model(robot, engine="numpy")
    base = Equations(model, ("q", "tau_m"), joints=robot.joint_names).base
    limits = MotionLimits.of(robot, workspace=Workspace.of(robot, floor=None, radius=0.01))
    result = optimise(
        model, limits, base.columns, rng=np.random.default_rng(0), evaluations=60, random=5, shape=Shape(harmonics=3)
    )
    assert result.condition_after < result.condition_before
    assert result.trajectory.joints == robot.joint_names


def test_random_motions_keep_the_limits(mod3: Model, limits: MotionLimits) -> None:
    """What a result is compared with is held to the same limits."""
    for motion in random_trajectories(mod3, limits, 5, rng=np.random.default_rng(0)):
        check_limits(limits, mod3, motion)


def test_limits_that_no_motion_meets_are_named(mod3: Model, arm: Robot, columns: np.ndarray) -> None:
    """With 5 Nm no pose of this arm can be held: the error says which joint asks for how much."""
    with pytest.raises(ExcitationError, match=r"at best the torque of joint_2 reaches \d+ % of its limit"):
        optimise(
            mod3, MotionLimits.of(arm, torque=5.0), columns, rng=np.random.default_rng(0), evaluations=20, random=2
        )
    with pytest.raises(ExcitationError, match="mm into the floor"):
        high = MotionLimits.of(arm, workspace=Workspace.of(arm, floor=3.0))
        optimise(mod3, high, columns, rng=np.random.default_rng(0), evaluations=20, random=2)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"criterion": "beauty"}, "no criterion 'beauty'"),
        ({"evaluations": 0}, "0 evaluations"),
        ({"random": 0}, "0 random motions"),
        ({"columns": ()}, "no base parameters"),
    ],
)
def test_wrong_options_are_refused(
    mod3: Model, limits: MotionLimits, columns: np.ndarray, options: dict, problem: str
) -> None:
    """An option without sense raises an error that names it."""
    given_ = {"columns": columns, "rng": np.random.default_rng(0), **options}
    with pytest.raises(ExcitationError, match=problem):
        optimise(mod3, limits, **given_)


@pytest.mark.parametrize("wrong", [{"harmonics": 0}, {"period": 0.0}, {"ramp": -1.0}, {"periods": 0}])
def test_wrong_shapes_are_refused(wrong: dict) -> None:
    """No harmonics, no time or no periods make no motion."""
    with pytest.raises(ExcitationError):
        Shape(**wrong)


def test_an_error_inside_the_search_comes_out(mod3: Model, limits: MotionLimits, columns: np.ndarray) -> None:
    """What the progress callback raises (Ctrl-C, say) ends the search and reaches the caller."""

    def stop(count: int, best: float) -> None:
        if count == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        optimise(mod3, limits, columns, rng=np.random.default_rng(0), evaluations=1000, random=2, progress=stop)


# --- figures and command


def test_figures_are_drawn(found: ExcitationResult, limits: MotionLimits, arm: Robot, tmp_path: Path) -> None:
    """Every figure of an excitation can be drawn and saved."""
    for name, figure in {
        "course": figures.search_course(found),
        "random": figures.condition_against_random(found),
        "motion": figures.joint_motion(found.trajectory, limits),
        "path": figures.tip_path(found.trajectory, arm),
    }.items():
        figure.savefig(tmp_path / f"{name}.svg")
        assert (tmp_path / f"{name}.svg").stat().st_size > 5000


def test_the_command_writes_a_trajectory_and_says_what_it_reached(tmp_path: Path) -> None:
    """`elastic-arm excite` writes a file that loads, a report, and JSON with the condition before and after."""
    app = typer.Typer()
    app.command()(excite)
    file = tmp_path / "t.yaml"
    arguments = ["--out", str(file), "--evaluations", "30", "--harmonics", "3", "--json", "--report", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["condition_number"]["after"] <= told["condition_number"]["before"]
    assert load_trajectory(file).joints == ("joint_1", "joint_2", "joint_3")
    assert "<svg" in (tmp_path / "report.html").read_text()


def test_describe_tells_joints_and_base_parameters() -> None:
    """`elastic-arm describe --json` gives the arm file's content, mass and named base parameters."""
    app = typer.Typer()
    app.command()(describe)
    told = json.loads(CliRunner().invoke(app, ["--json"]).stdout)
    assert told["mass_kg"] == pytest.approx(139.0)
    assert [joint["name"] for joint in told["robot"]["joints"]] == ["joint_1", "joint_2", "joint_3"]
    assert len(told["base_parameters"]) == 26
    plain = CliRunner().invoke(app, ["--base"])
    assert "joint_3.K [Nm/rad]" in plain.stdout


@pytest.mark.parametrize(
    "arguments", [["--harmonics", "0"], ["--criterion", "beauty"], ["--robot", "none.yaml"], ["--torque", "-3"]]
)
def test_the_command_refuses_what_makes_no_sense(tmp_path: Path, arguments: list[str]) -> None:
    """Unusable options end with status 2 and one line on stderr."""
    app = typer.Typer()
    app.command()(excite)
    result = CliRunner().invoke(app, ["--out", str(tmp_path / "t.yaml"), *arguments])
    assert result.exit_code == 2
    assert "error:" in result.stderr
    assert not (tmp_path / "t.yaml").exists()
