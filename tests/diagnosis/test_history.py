"""What changed of an arm over recordings, when and by how much."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from elastic_arm.app import app
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.history import Course, changed_of_each, courses, courses_of_each, step_of
from elastic_arm.diagnosis.result import ParameterEstimate
from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.segments import in_parts
from elastic_arm.excitation import Shape, random_trajectories
from elastic_arm.recording import Recording
from elastic_arm.report.history import write_history_report
from elastic_arm.sensors import Sensors
from tests.helpers.gap_recordings import LIMITS, MODEL, ROBOT, motions, record

COMMON = 4e-4  # variance that all sizes share, Nm²


def test_a_step_is_found_where_it_is_with_its_levels() -> None:
    """Levels are means of the sizes on either side, and what all sizes share widens them and hides no step."""
    values = np.array([6.0, 6.01, 5.99, 9.0, 9.01])
    step = step_of(values, 1e-4 * np.eye(5) + COMMON)
    assert step.after == 2 and step.probability > 0.999
    assert step.before_value == pytest.approx(6.0, abs=1e-3) and step.after_value == pytest.approx(9.005, abs=1e-3)
    assert step.before_std == pytest.approx(np.sqrt(1e-4 / 3 + COMMON), rel=1e-6)


def test_a_drift_within_the_deviations_names_no_place() -> None:
    """Of sizes that rise evenly by less than they are known to, no place is certain."""
    assert step_of(np.linspace(6.0, 6.1, 6), 0.01 * np.eye(6)).probability < 0.5


def test_friction_that_rises_is_a_change_and_other_friction_is_none(tmp_path: Path) -> None:
    """From 6 to 9 Nm at one joint, known to 2 %; that of another stays the same. The report draws each number."""
    effects = [f"coulomb_friction:joint_1:torque=5|coulomb_friction:joint_2:torque={size}" for size in (6, 9)]
    first, second = (
        replace(record(motions()[0], *each.split("|"), seed=k), source=f"day_{k}") for k, each in enumerate(effects)
    )
    judge = replace(record(motions()[1], *effects[0].split("|"), seed=2), source="judge")
    whole = diagnose([first, second], Question(ROBOT, effects=(EFFECTS["coulomb_friction"],)), [judge])
    found = courses(whole)
    one, other = (next(c for c in found if c.sized.joint == joint) for joint in ("joint_2", "joint_1"))
    assert one.changed > 0.99 and one.step is not None and one.step.after == 0
    assert one.sized.values == pytest.approx([6.0, 9.0], rel=0.02)
    assert other.changed < 0.5 and other.step is None
    assert np.abs(other.sized.values - 5.0).max() < 0.1
    assert found[0] is one
    told = one.to_dict(("day_0", "day_1"))
    assert told["step"]["between"] == ["day_0", "day_1"] and told["unit"] == "Nm"
    page = write_history_report(tmp_path / "report.html", whole, found, ("2026-03-03 06:00:00",) * 2).read_text()
    assert "coulomb friction of joint_2 rose from" in page and page.count("<svg") == len(found)
    with pytest.raises(DiagnosisError, match="two recordings"):
        courses(replace(whole, identify=("day_0",)))


@pytest.mark.slow(5)
def test_a_payload_that_is_picked_up_and_kept_is_a_change_between_parts_of_a_recording() -> None:
    """From none to 2 kg at half of it; one payload throughout would be as far from either."""
    shape = Shape(5, 7.0, 1.0)
    first, second = random_trajectories(MODEL, LIMITS, 2, rng=np.random.default_rng(3), shape=shape)
    empty = record(first, sensors=Sensors.real())
    loaded = record(second, "payload:mass=2.0", seed=1, sensors=Sensors.real())
    later = {n: replace(s, stamp_ns=s.stamp_ns + 12 * 10**9) for n, s in loaded.sides().items() if s is not None}
    parts = in_parts(replace(Recording.joined([empty, replace(loaded, **later)]), source="run"))
    assert [part.source for part in parts] == ["run, 0 to 12 s", "run, 12 to 21 s"]
    (found,) = courses(diagnose(parts, Question(ROBOT, effects=(EFFECTS["payload"],))))
    assert found.sized.effect == "payload" and found.changed > 0.99 and found.step is not None
    assert found.sized.values == pytest.approx([0.0, 2.0], abs=0.02)


def test_sizes_of_single_recordings_differ_by_more_than_their_deviations() -> None:
    """Noise of ten recordings is no change in a hundred histories; a step of ten deviations is."""
    noise = np.random.default_rng(0).normal(6.0, 0.01, (100, 10))
    assert max(changed_of_each(values, np.full(10, 1e-4)) for values in noise) < 0.5
    noise[:, 7:] += 0.1
    assert min(changed_of_each(values, np.full(10, 1e-4)) for values in noise) > 0.99


def test_a_cause_that_appears_for_good_is_a_change_and_one_that_may_hide_is_none() -> None:
    """2 kg from the third recording on; 0.3 kg that the first cannot tell; one now and then; nothing from `unknown`."""

    def courses_of(*masses: float | None, std: float, verdict: str = "explained", shown: int = 1) -> tuple[Course, ...]:
        sizes = ({"mass": ParameterEstimate(mass, std, "kg")} if mass else None for mass in masses)
        causes = ([SimpleNamespace(effect="payload", joint="joint_3", parameters=one)] if one else [] for one in sizes)
        return courses_of_each(
            [SimpleNamespace(known=[], causes=c, verdict="explained" if len(c) == shown else verdict) for c in causes]
        )  # type: ignore[misc]

    (payload,) = courses_of(None, None, 2.0, 2.0, std=0.01)
    assert payload.changed > 0.99 and payload.step is not None and payload.step.until == 2
    assert payload.step.before_value == pytest.approx(0.0, abs=1e-6)
    (hidden,) = courses_of(None, None, 0.3, 0.3, std=0.1)
    (now_and_then,) = courses_of(2.0, None, 2.0, None, 2.0, std=0.01)
    assert hidden.changed < 0.5 and now_and_then.changed < 0.5
    (alone,) = courses_of(None, None, 2.0, 2.0, std=0.01, verdict="unknown")
    (doubtful,) = courses_of(1.0, 1.0, 2.0, 2.0, std=0.01, verdict="unknown", shown=0)
    assert alone.changed < 0.5 and doubtful.changed < 0.5


def test_a_folder_without_bags_is_refused(tmp_path: Path) -> None:
    """In one line that says what to name."""
    result = CliRunner().invoke(app, ["history", str(tmp_path)])
    assert result.exit_code == 2 and "holds no bags" in result.stderr
