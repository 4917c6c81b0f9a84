"""Excitation: criteria that are their formulas, and a search that improves on chance within the
limits."""

import os
import signal
import threading
import time

import numpy as np
import pytest

from elastic_arm.dynamics import Model, build_model
from elastic_arm.errors import ExcitationError
from elastic_arm.excitation import (
    CRITERIA,
    BaseRegressor,
    ExcitationResult,
    MotionLimits,
    Shape,
    Workspace,
    optimise,
    problem,
    random_trajectories,
)
from elastic_arm.excitation.criteria import distinct_columns, elastic_motion
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.robot import Robot, load_robot
from tests.helpers.motions import trajectory
from tests.helpers.random_arms import random_arm


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot()


@pytest.fixture(scope="module")
def mod3(arm: Robot) -> Model:
    return build_model(arm, "mod3")


@pytest.fixture(scope="module")
def columns(mod3: Model) -> np.ndarray:
    return BaseRegression(mod3, ("q", "theta", "tau_m")).base.columns


@pytest.fixture(scope="module")
def limits(arm: Robot) -> MotionLimits:
    return MotionLimits.of(arm)


# --- criteria


def test_criteria_of_orthonormal_columns() -> None:
    """Orthonormal columns in their own scale: condition 1, and zero decades of uncertainty."""
    W = np.linalg.qr(np.random.default_rng(0).normal(size=(50, 6)))[0]
    values = {name: criterion(W, np.ones(6)) for name, criterion in CRITERIA.items()}
    assert values == pytest.approx(
        {"condition": 1.0, "d_optimal": 0.0, "a_optimal": 0.0}, abs=1e-12
    )


def test_criteria_are_what_their_formulas_say() -> None:
    """Each criterion equals its formula by the normal equations, columns in units of `scale`."""
    rng = np.random.default_rng(1)
    W = rng.normal(size=(40, 4))
    scale = np.array([1.0, 2.0, 0.5, 3.0])
    N = (W / scale).T @ (W / scale)
    assert CRITERIA["condition"](W, scale) == pytest.approx(np.sqrt(np.linalg.cond(N)))
    assert CRITERIA["d_optimal"](W, scale) == pytest.approx(-np.log10(np.linalg.det(N)) / 8)
    assert CRITERIA["a_optimal"](W, scale) == pytest.approx(
        0.5 * np.log10(np.trace(np.linalg.inv(N)) / 4)
    )


def test_dependent_columns_are_the_worst_finite_number() -> None:
    """A dependent column gives a condition number beyond 1e14, not infinity or an error."""
    W = np.random.default_rng(2).normal(size=(30, 3))
    W[:, 2] = W[:, 0] - W[:, 1]
    assert 1e14 < CRITERIA["condition"](W, np.ones(3)) < np.inf


def test_noise_divides_the_rows_of_its_equation(mod3: Model, columns: np.ndarray) -> None:
    """Twice the noise in all equations halves the base regressor; in one, its rows alone."""
    motion = trajectory(periods=1)
    noise = np.ones(6)
    noise[4] = 2.0
    plain = BaseRegressor(mod3, columns)(motion)
    weighted = BaseRegressor(mod3, columns, noise)(motion)
    ratio = np.ones((150, 6))
    ratio[:, 4] = 0.5
    np.testing.assert_allclose(weighted, plain * ratio.ravel()[:, None])


def test_the_motors_lead_so_that_the_link_side_is_in_balance(mod3: Model, arm: Robot) -> None:
    """In the motion that is judged, K (theta - q) bears the link side's torque to a part in a
    thousand."""
    motion = trajectory(periods=1)
    x, dx, ddx = elastic_motion(mod3, motion, 200)
    K = np.array([j.transmission.stiffness for j in arm.joints])
    carried = K * (x[:, 3:] - x[:, :3])
    residual = mod3.inverse_dynamics(x, dx, ddx)[:, :3]
    damping = np.array([j.transmission.damping for j in arm.joints]) * (dx[:, 3:] - dx[:, :3])
    assert np.abs(residual + damping).max() < 1e-3 * np.abs(carried).max()


def test_what_only_a_soft_arm_could_tell_apart_is_left_out(
    mod3: Model, arm: Robot, columns: np.ndarray
) -> None:
    """In mod3, S_11 asks for q'' and theta'' to differ, so one of its columns is left out; in mod1
    there is none."""
    motions = [trajectory(seed, periods=1).scaled(0.3) for seed in range(5)]
    W = np.concatenate([BaseRegressor(mod3, columns)(motion) for motion in motions])
    dropped = set(range(len(columns))) - set(distinct_columns(W).tolist())
    names = [mod3.parameters[columns[k]].name for k in dropped]
    assert len(names) == 1
    assert names[0].startswith("joint_1.")
    mod1 = build_model(arm, "mod1")
    own = BaseRegression(mod1, ("q", "theta", "tau_m")).base.columns
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
    """At ten times as many times as the search looks at, every limit is kept, and the margin to
    floor and links too."""
    use = limits.use(found.trajectory, mod3, np.linspace(0, found.trajectory.duration, 4000))
    assert (use.excess[:4] <= 0).all()
    # Gaps move by less than the motion between two samples of the search.
    assert min(use.floor, use.links) > limits.margin - 2e-3


def test_the_same_generator_gives_the_same_motion(
    mod3: Model, limits: MotionLimits, columns: np.ndarray
) -> None:
    """The search is a function of its seed, also when searches follow one another in a process."""
    runs = [
        optimise(
            mod3, limits, columns, rng=np.random.default_rng(seed), evaluations=60, random=3
        ).trajectory
        for seed in (1, 2, 1)
    ]
    np.testing.assert_array_equal(runs[0].a, runs[2].a)
    assert not np.array_equal(runs[0].a, runs[1].a)


@pytest.mark.parametrize("criterion", ["d_optimal", "a_optimal"])
def test_the_other_criteria_improve_too(
    mod3: Model, limits: MotionLimits, columns: np.ndarray, criterion: str
) -> None:
    """Whatever the criterion, its value falls, and every evaluation is told."""
    told: list[int] = []
    result = optimise(
        mod3,
        limits,
        columns,
        rng=np.random.default_rng(4),
        evaluations=80,
        random=4,
        criterion=criterion,
        progress=lambda count, best: told.append(count),
    )
    assert result.value_after < result.value_before
    assert told == list(range(1, 81))


def test_an_arm_of_five_rigid_joints_is_excited() -> None:
    """Nothing is made for three joints or for transmissions; the floor is left out, as this arm is
    drawn at random."""
    robot = random_arm(5, np.random.default_rng(8), elastic=False)
    model = build_model(robot, engine="numpy")
    base = BaseRegression(model, ("q", "tau_m"), joints=robot.joint_names).base
    limits = MotionLimits.of(robot, workspace=Workspace.of(robot, floor=None, radius=0.01))
    result = optimise(
        model,
        limits,
        base.columns,
        rng=np.random.default_rng(0),
        evaluations=60,
        random=5,
        shape=Shape(harmonics=3),
    )
    assert result.condition_after < result.condition_before
    assert result.trajectory.joints == robot.joint_names


def test_random_motions_keep_the_limits(mod3: Model, limits: MotionLimits) -> None:
    """What a result is compared with is held to the same limits."""
    motions = random_trajectories(mod3, limits, 5, rng=np.random.default_rng(0))
    assert len(motions) == 5
    assert max(limits.use(motion, mod3).excess.max() for motion in motions) <= 0.0


def test_random_motions_are_found_where_few_places_are_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the links are thick, most random places are in the floor or in another link; others are
    sought then."""
    robot = random_arm(6, np.random.default_rng(6))
    model = build_model(robot)
    limits = MotionLimits.of(robot)
    monkeypatch.setattr(problem, "PLACES", 10)
    (motion,) = random_trajectories(model, limits, 1, rng=np.random.default_rng(0))
    assert limits.use(motion, model).kept
    monkeypatch.setattr(problem, "DRAWN", 0)
    with pytest.raises(ExcitationError, match="a random motion violates the limits everywhere"):
        random_trajectories(model, limits, 1, rng=np.random.default_rng(0))


@pytest.mark.slow(4)
def test_limits_that_no_motion_meets_are_named(
    mod3: Model, arm: Robot, columns: np.ndarray
) -> None:
    """With 5 Nm no pose of this arm can be held: the error says which joint asks for how much."""
    with pytest.raises(
        ExcitationError, match=r"the best one: the torque of joint_2 reaches \d+ % of its limit"
    ):
        optimise(
            mod3,
            MotionLimits.of(arm, torque=5.0),
            columns,
            rng=np.random.default_rng(0),
            evaluations=20,
            random=2,
        )
    with pytest.raises(ExcitationError, match=r"mm of the floor|penetrates the floor"):
        high = MotionLimits.of(arm, workspace=Workspace.of(arm, floor=3.0))
        optimise(mod3, high, columns, rng=np.random.default_rng(0), evaluations=20, random=2)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"criterion": "beauty"}, "unknown criterion 'beauty'"),
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


@pytest.mark.parametrize(
    "wrong", [{"harmonics": 0}, {"period": 0.0}, {"ramp": -1.0}, {"periods": 0}]
)
def test_wrong_shapes_are_refused(wrong: dict) -> None:
    """No harmonics, no time or no periods make no motion."""
    with pytest.raises(ExcitationError):
        Shape(**wrong)


def test_an_error_inside_the_search_comes_out(
    mod3: Model, limits: MotionLimits, columns: np.ndarray
) -> None:
    """What the progress callback raises (Ctrl-C, say) ends the search and reaches the caller."""

    def stop(count: int, best: float) -> None:
        if count == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        optimise(
            mod3,
            limits,
            columns,
            rng=np.random.default_rng(0),
            evaluations=1000,
            random=2,
            progress=stop,
        )


NEVER = 2000


def signalled(
    columns: np.ndarray, limits: MotionLimits, mod3: Model, *, elsewhere: bool
) -> ExcitationResult:
    """Search, and get a SIGINT while NOMAD is about to call for the sixth time, in this thread or
    in another one."""
    sent = threading.Event()

    def send() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        sent.set()

    def stop(count: int, best: float) -> None:
        if count == 5 and elsewhere:  # where SIGINT is not held back
            threading.Thread(target=send).start()
            sent.wait()
        elif count == 5:
            send()

    rng = np.random.default_rng(0)
    return optimise(mod3, limits, columns, rng=rng, evaluations=NEVER, random=2, progress=stop)


@pytest.mark.parametrize("elsewhere", [False, True])
def test_an_interrupt_is_heeded_in_whatever_thread_it_comes(
    mod3: Model, limits: MotionLimits, columns: np.ndarray, elsewhere: bool
) -> None:
    """One that another thread takes goes to NOMAD, which ends as if the search were done: its
    reason says it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            signalled(columns, limits, mod3, elsewhere=elsewhere)
            time.sleep(5.0)
    finally:
        signal.signal(signal.SIGINT, before)
