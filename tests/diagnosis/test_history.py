"""What changed of an arm over recordings, when and by how much."""

import json
import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm
from typer.testing import CliRunner

from elastic_arm.app import app
from elastic_arm.arrays import Array
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.changes import SizedTerm
from elastic_arm.diagnosis.history import Course, course_of, courses, courses_of_each
from elastic_arm.diagnosis.result import ParameterEstimate, from_dict
from elastic_arm.effects import EFFECTS, Catalogue
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.segments import in_parts
from elastic_arm.evidence.priors import ODDS, SCATTER, STEP, UNSURE
from elastic_arm.excitation import Shape, random_trajectories
from elastic_arm.recording import Recording, write_recording
from elastic_arm.report.history import write_history_report
from elastic_arm.sensors import Sensors
from tests.helpers.gap_recordings import LIMITS, MODEL, ROBOT, motions, record

COMMON = 4e-4  # variance that all sizes share, Nm²
N = 10  # numbers of the arm


def course(values: Array | list[float], covariance: Array, wrong: float = ODDS / N) -> Course:
    """Return the course of one of the arm's frictions."""
    sized = SizedTerm("coulomb_friction", "joint_1", "torque", "Nm", np.array(values), covariance)
    return course_of(sized, np.full(len(values), wrong), 1.0, STEP / N)


def test_a_step_is_found_where_it_is_with_its_levels() -> None:
    """Levels are means of the sizes on either side; what all sizes share, and little scatter, widen
    them."""
    found = course([6.0, 6.01, 5.99, 9.0, 9.01, 8.99], 1e-4 * np.eye(6) + COMMON)
    step = found.step
    assert found.changed > 0.99 and step is not None and step.after == 2 and step.probability > 0.99
    assert step.before_value == pytest.approx(6.0, abs=3e-3) and step.after_value == pytest.approx(
        9.0, abs=3e-3
    )
    least = np.sqrt(1e-4 / 3 + COMMON)
    assert least < step.before_std < 2.0 * least and least < step.after_std < 2.0 * least


def test_the_posterior_of_a_step_of_two_sizes_is_that_of_the_integrals() -> None:
    """By adaptive quadrature over level and scatter, for two sizes of 6.0 and 6.5 ± 0.1 Nm, none
    wrong."""
    x, s, R = np.array([6.0, 6.5]), 0.1, 6.5

    def evidence(t: float) -> tuple[float, float]:
        v = s**2 + t**2 * (s**2 + (SCATTER * R) ** 2)
        same = multivariate_normal(np.zeros(2), v * np.eye(2) + R**2).pdf(x)
        return float(same), float(np.prod(norm(0.0, np.sqrt(v + R**2)).pdf(x)))

    same, apart = (quad(lambda t, k=k: np.exp(-t) * evidence(t)[k], 0.0, 60.0)[0] for k in (0, 1))
    expected = STEP / N * apart / (same + STEP / N * apart)
    assert course(x, s**2 * np.eye(2), wrong=1e-12).changed == pytest.approx(expected, rel=0.02)


def test_scatter_is_no_change_and_a_step_beyond_it_is() -> None:
    """Of 1000 recordings in histories of ten, scattered as the prior states, at most 1 in 200 has a
    false change."""
    rng = np.random.default_rng(0)
    t = rng.exponential(1.0, (100, 1))
    stds = np.sqrt(0.02**2 + t**2 * (0.02**2 + (SCATTER * 6.0) ** 2))
    sizes = 6.0 + stds * rng.standard_normal((100, 10))
    assert sum(course(one, 4e-4 * np.eye(10)).step is not None for one in sizes) <= 5
    sizes[:, 6:] += 12.0 * stds
    told = [course(one, 4e-4 * np.eye(10)).step for one in sizes[:50]]
    assert sum(step is not None and step.after == 5 for step in told) >= 48


def test_a_drift_within_the_deviations_and_two_sizes_of_an_unknown_arm_are_no_change() -> None:
    """A size that holds a part of what is unknown may be wrong; sizes that agree again and again
    are not all wrong."""
    assert course(np.linspace(6.0, 6.1, 6), 0.01 * np.eye(6)).changed < 0.01
    assert course([6.0, 9.0], 4e-4 * np.eye(2), UNSURE).changed < 0.05
    assert course([6.0] * 6 + [9.0] * 6, 4e-4 * np.eye(12), UNSURE).changed > 0.99
    assert course([6.0] * 6 + [9.0] + [6.0] * 5, 4e-4 * np.eye(12)).changed < 0.01


def test_friction_that_rises_is_a_change_and_other_friction_is_none(tmp_path: Path) -> None:
    """From 6 to 9 Nm at one joint, known to 2 %; that of another stays the same. The report draws
    each number."""
    effects = [
        f"coulomb_friction:joint_1:torque=5|coulomb_friction:joint_2:torque={size}"
        for size in (6, 9)
    ]
    first, second = (
        replace(record(motions()[0], *each.split("|"), seed=k), source=f"day_{k}")
        for k, each in enumerate(effects)
    )
    judge = replace(record(motions()[1], *effects[0].split("|"), seed=2), source="judge")
    whole = diagnose(
        [first, second], Question(ROBOT, effects=(EFFECTS["coulomb_friction"],)), [judge]
    )
    (change,) = whole.changes
    assert (change.effect, change.joint, change.parameter) == (
        "coulomb_friction",
        "joint_2",
        "torque",
    )
    assert change.confidence > 0.9
    found = courses(whole)
    one, other = (
        next(c for c in found if c.sized.joint == joint) for joint in ("joint_2", "joint_1")
    )
    assert one.changed > 0.99 and one.step is not None and one.step.after == 0
    assert one.sized.values == pytest.approx([6.0, 9.0], rel=0.02)
    assert other.changed < 0.5 and other.step is None
    assert np.abs(other.sized.values - 5.0).max() < 0.1
    assert found[0] is one
    told = one.to_dict(("day_0", "day_1"))
    assert told["step"]["between"] == ["day_0", "day_1"] and told["unit"] == "Nm"
    page = write_history_report(
        tmp_path / "report.html", whole, found, ("2026-03-03 06:00:00",) * 2
    ).read_text()
    assert "coulomb friction of joint_2 rose from" in page and page.count("<svg") == len(found)
    # between processes
    again = from_dict(pickle.loads(pickle.dumps(whole.to_dict())), tmp_path, Catalogue.default())
    assert [c.effect for c in again.causes] == [c.effect for c in whole.causes] and again.causes
    with pytest.raises(DiagnosisError, match="two recordings"):
        courses(replace(whole, identify=("day_0",)))


def test_what_a_recording_lacks_the_channels_for_is_not_compared() -> None:
    """Without motor torques friction is not absent; beside all channels a recording without it
    shows that it is."""
    link, motor = ("joint_1", "link"), ("joint_1", "motor")
    size = ParameterEstimate(6.0, 0.01, "Nm")
    friction = SimpleNamespace(
        effect="coulomb_friction", joint="joint_1", parameters={"torque": size}
    )
    every = SimpleNamespace(
        known=[], causes=[friction], verdict="explained", noise={link: 0.1, motor: 0.1}
    )
    without = SimpleNamespace(known=[], causes=[], verdict="none", noise={link: 0.1})
    (lacking,) = courses_of_each([every, every, without, without])  # type: ignore[list-item]
    assert lacking.step is None and np.isnan(lacking.sized.values[2:]).all()
    without.noise = every.noise
    (absent,) = courses_of_each([every, every, without, without])  # type: ignore[list-item]
    assert (
        absent.step is not None
        and absent.step.after == 1
        and (absent.sized.values[2:] == 0.0).all()
    )


@pytest.mark.nightly
@pytest.mark.slow(26)
def test_a_payload_that_is_picked_up_and_kept_is_a_change_between_parts_of_a_recording() -> None:
    """From none to 2 kg at half of it; one payload throughout would be as far from either."""
    shape = Shape(5, 7.0, 1.0)
    first, second = random_trajectories(MODEL, LIMITS, 2, rng=np.random.default_rng(3), shape=shape)
    empty = record(first, sensors=Sensors.real(), rate=1000.0)
    loaded = record(second, "payload:mass=2.0", seed=1, sensors=Sensors.real(), rate=1000.0)
    later = {
        n: replace(s, stamp_ns=s.stamp_ns + 12 * 10**9)
        for n, s in loaded.sides().items()
        if s is not None
    }
    parts = in_parts(replace(Recording.joined([empty, replace(loaded, **later)]), source="run"))
    assert [part.source for part in parts] == ["run, 0 to 12 s", "run, 12 to 21 s"]
    (found,) = courses(diagnose(parts, Question(ROBOT, effects=(EFFECTS["payload"],))))
    assert found.sized.effect == "payload" and found.changed > 0.99 and found.step is not None
    assert found.sized.values == pytest.approx([0.0, 2.0], abs=0.02)


def test_a_cause_that_appears_for_good_is_a_change_and_one_that_may_hide_is_none() -> None:
    """2 kg from the third recording on; 0.3 kg that the first cannot tell; one now and then; less
    from `unknown`."""

    def courses_of(
        *masses: float | None, std: float, verdict: str = "explained", shown: int = 1
    ) -> tuple[Course, ...]:
        sizes = ({"mass": ParameterEstimate(mass, std, "kg")} if mass else None for mass in masses)
        causes = (
            [SimpleNamespace(effect="payload", joint="joint_3", parameters=one)] if one else []
            for one in sizes
        )
        return courses_of_each(
            [
                SimpleNamespace(
                    known=[],
                    causes=c,
                    verdict="explained" if len(c) == shown else verdict,
                    noise={},
                )
                for c in causes
            ]
        )  # type: ignore[misc]

    (payload,) = courses_of(None, None, 2.0, 2.0, std=0.01)
    assert payload.changed > 0.99 and payload.step is not None and payload.step.until == 2
    assert payload.step.before_value == pytest.approx(0.0, abs=1e-3)
    (hidden,) = courses_of(None, None, 0.3, 0.3, std=0.1)
    (now_and_then,) = courses_of(2.0, None, 2.0, None, 2.0, std=0.01)
    assert hidden.changed < 0.5 and now_and_then.changed < 0.5
    (alone,) = courses_of(None, None, 2.0, 2.0, std=0.01, verdict="unknown")
    (doubtful,) = courses_of(1.0, 1.0, 2.0, 2.0, std=0.01, verdict="unknown", shown=0)
    assert doubtful.changed < 0.5 and doubtful.changed < alone.changed < payload.changed


@pytest.mark.nightly
def test_a_bag_that_cannot_be_read_is_left_out_and_named(tmp_path: Path) -> None:
    """The others make the history; two are needed."""
    (motion,) = random_trajectories(
        MODEL, LIMITS, 1, rng=np.random.default_rng(3), shape=Shape(3, 7.0, 1.0)
    )
    bags = [str(tmp_path / name) for name in ("march", "april", "torn")]
    for seed, bag in enumerate(bags):
        write_recording(bag, record(motion, seed=seed, sensors=Sensors.real()))
    (tmp_path / "torn" / "torn_0.mcap").write_bytes(b"")
    options = ["--with", "coulomb_friction:joint_2", "--out", str(tmp_path / "history")]
    result = CliRunner().invoke(app, ["history", *bags, *options])
    assert result.exit_code == 0 and "skipped: " in result.stderr and "torn" in result.stderr, (
        result.output
    )
    told = json.loads((tmp_path / "history" / "history.json").read_text())
    assert {Path(one["recording"]).name for one in told["recordings"]} == {"march", "april"}
    assert any(note.startswith("skipped: ") for note in told["notes"])
    assert CliRunner().invoke(app, ["history", *bags[1:], *options, "--force"]).exit_code == 2


def test_a_folder_without_bags_is_refused(tmp_path: Path) -> None:
    """In one line that says what to name."""
    result = CliRunner().invoke(app, ["history", str(tmp_path)])
    assert result.exit_code == 2 and "contains no .mcap or .db3 file" in result.stderr
