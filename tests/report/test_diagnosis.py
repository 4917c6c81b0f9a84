"""The results of a diagnosis: report, files and words, opened and used as a user would."""

import csv
import html
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from elastic_arm.app import load
from elastic_arm.cli.application import spelled_out
from elastic_arm.cli.console import UNLIMITED
from elastic_arm.cli.diagnose import save_diagnosis
from elastic_arm.cli.diagnosis_printing import print_diagnosis
from elastic_arm.diagnosis import Question, diagnose, follow_up
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.diagnosis.estimates import ParameterEstimate
from elastic_arm.diagnosis.result import SEPARATING, Change, Diagnosis, ResidualSizes
from elastic_arm.diagnosis.words import cause_sentence, estimates_text, probability_text, summary
from elastic_arm.effects.effect import REGIMES
from elastic_arm.recording import read_recording
from elastic_arm.recording.message_types import typestore
from elastic_arm.recording.storage.messages import read_messages
from elastic_arm.report.diagnosis import sections, write_gap_report
from elastic_arm.report.diagnosis_figures import (
    angle_within_turn,
    friction_at,
    places_with_friction,
    shown_sides,
)
from elastic_arm.report.html import Table
from elastic_arm.report.legend import meaning
from tests.helpers.browser import rendered_page
from tests.helpers.command_line import run
from tests.helpers.gap_recordings import ROBOT, motions, record
from tests.helpers.shared_diagnoses import ERROR, FRICTION, Commanded

pytestmark = pytest.mark.slow(40)


@pytest.mark.browser
def test_report_shows_verdict_map_causes_and_prediction_in_a_browser(
    two_causes: Diagnosis, tmp_path: Path
) -> None:
    """A real browser shows verdict first, then where and each cause; all behind these is folded."""
    page = rendered_page(
        write_gap_report(tmp_path / "report.html", two_causes), tmp_path / "profile"
    )
    folded = re.findall(r"<details><summary><h2>([^<]*)</h2>", page)
    assert (
        folded[0] == "Before and after"
        and folded[-1] == "Basis of this diagnosis"
        and "Verdict" not in folded
    )
    titles = re.findall(r"<h2>([^<]*)</h2>", page)
    assert titles[:2] == ["Verdict", "Location of the gap"]
    assert {"coulomb friction, joint_2", "transmission error, joint_1"} < set(titles)
    assert {"Before and after", "Prediction horizon", "What the residuals depend on"} < set(titles)
    assert page.index("explained: ") < page.index("<svg")
    # Map, two causes, horizons are drawings; what is over time can be zoomed: two causes, and nine
    # residuals.
    assert (page.count("<svg"), page.count("<canvas")) == (5, 2 + 9)
    assert len(page.encode()) < 3e6 and not re.findall(r'(?:src|href)="http', page)
    for words in (
        "velocity [rad/s]",
        "wave generator angle",
        "frequency [Hz]",
        "horizon [ms]",
        "Trust in the",
        "time [s]",
        "Nm/√Hz",
        "prediction error [µrad]",
        "residual, Nm",
    ):
        assert words in page


def test_every_column_of_the_report_is_explained(two_causes: Diagnosis) -> None:
    """Below a table stands what each of its columns means, but for joints, times and what residuals
    follow."""
    tables = [
        block for part in sections(two_causes) for block in part.blocks if isinstance(block, Table)
    ]
    named = {"joint", *(regime.replace("_", " ") for regime in REGIMES)}
    bare = [
        head for table in tables for head in table.header if not meaning(head) and head not in named
    ]
    assert len(tables) >= 5 and not [head for head in bare if " ms" not in head]


def test_prediction_is_written_as_numbers(two_causes: Diagnosis, tmp_path: Path) -> None:
    """What follows a diagnosis stands beside the contract's fields."""
    data = json.loads(two_causes.save(tmp_path / "diagnosis.json").read_text())
    assert data["prediction"]["horizons_s"] == [0.01, 0.02, 0.05, 0.1, 0.2]
    before, after = (data["prediction"][when]["joint_2"]["motor"] for when in ("before", "after"))
    assert before[-1] > 10 * after[-1] and data["next_motion"] is None


def test_report_of_a_clean_arm_speaks_of_no_cause(
    clean_diagnosis: Diagnosis, tmp_path: Path
) -> None:
    """Where there is no gap, the report shows residuals and noise, and nothing before and after."""
    found = follow_up(clean_diagnosis, rng=None)
    page = write_gap_report(tmp_path / "report.html", found).read_text()
    titles = re.findall(r"<h2>([^<]*)</h2>", page)
    assert "none: recording and model agree" in page
    assert "The residuals" in titles and "Before and after" not in titles
    assert "after" not in "".join(re.findall(r"<th>([^<]*)</th>", page))


def test_gap_without_an_effect_for_it_is_drawn_as_unexplained(tmp_path: Path) -> None:
    """With nothing in the catalogue that could explain it, the report shows where the gap is and
    what it looks like."""
    recordings = [record(motion, FRICTION, seed=k) for k, motion in enumerate(motions())]
    found = diagnose([recordings[0]], Question(ROBOT, effects=()), [recordings[1]])
    page = write_gap_report(tmp_path / "report.html", found).read_text()
    assert found.verdict == "unknown" and {p.joint for p in found.unexplained} == {"joint_2"}
    assert "Unexplained residuals" in page
    assert "joint_2, motor side: the place with the largest remaining residual" in page
    assert "The verdict is unknown because of" in page and "Record next: joint_2 alone" in page
    sizes = [place.rmse for place in found.unexplained]
    assert sizes == sorted(sizes, reverse=True)


def test_arm_with_the_causes_in_it_has_no_gap_left(two_causes: Diagnosis) -> None:
    """Diagnosed against the arm file that the diagnosis wrote, a new recording agrees with the
    model."""
    repaired = repaired_robot(ROBOT, two_causes)
    assert {e["effect"] for e in repaired.effects} == {"coulomb_friction", "transmission_error"}
    recordings = [record(motion, FRICTION, ERROR, seed=7 + k) for k, motion in enumerate(motions())]
    question = Question(repaired, effects=["coulomb_friction", "transmission_error", "hysteresis"])
    found = diagnose([recordings[0]], question, [recordings[1]])
    assert (found.verdict, found.causes) == ("none", ())


def test_command_writes_the_motion_that_the_simulator_takes(
    commanded: Commanded, tmp_path: Path
) -> None:
    """Two bags give result, report, arm and separating motion; `simulate --trajectory` takes the
    motion as it is."""
    folder = commanded.folder / "diagnosis"
    tables = {"causes.csv", "gap.csv", "parameters.csv", "residuals.csv"}
    assert {p.name for p in folder.iterdir()} == {
        "diagnosis.json",
        "report.html",
        "robot.yaml",
        SEPARATING,
        *tables,
    }
    check_residuals(folder / "residuals.csv", commanded.folder)
    words = " ".join(commanded.told.stdout.split())
    assert (
        f"separated by: {SEPARATING}" in words
        and "prediction: Driven by the measured torque" in words
    )
    told = run(
        "simulate",
        "--out",
        tmp_path / "next",
        "--trajectory",
        folder / SEPARATING,
        "--duration",
        1.0,
    )
    assert told.exit_code == 0, told.output
    assert read_recording(tmp_path / "next").duration == pytest.approx(1.0, abs=0.01)


def test_the_layout_of_residuals_shows_what_the_bag_holds(two_causes: Diagnosis) -> None:
    """Every curve of layouts/residuals.json is a residual of the bag, and every panel has its
    place."""
    layout = json.loads((Path(__file__).parents[2] / "layouts" / "residuals.json").read_text())
    panels = layout["configById"]
    curves = [
        p["value"]
        for name, panel in panels.items()
        if name.startswith("Plot!")
        for p in panel["paths"]
    ]
    topics = {
        f"{topic}.effort[{k}]"
        for topic in two_causes.residual_sides(two_causes.validate[0], 0)
        for k in range(ROBOT.n)
    }
    assert set(curves) == topics
    assert sorted(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))) == sorted(panels)


def check_residuals(table: Path, folder: Path) -> None:
    """The bag of residuals is the recording that judged, and its topics hold at each time what the
    table has."""
    rows = list(csv.DictReader(table.read_text().splitlines()))
    messages = list(read_messages(folder / "residuals", {"/residuals/motor/before"}))
    assert (
        read_recording(folder / "residuals").duration == read_recording(folder / "bag_2").duration
    )
    assert len(messages) == len(rows)
    states = [
        typestore().deserialize_cdr(m.data, "sensor_msgs/msg/JointState") for m in messages[::50]
    ]
    effort = [float(row["joint_2.motor.before"]) for row in rows[::50]]
    np.testing.assert_allclose([state.effort[1] for state in states], effort, rtol=1e-6)
    stamps = [state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec for state in states]
    np.testing.assert_allclose(stamps, [float(row["t"]) for row in rows[::50]], atol=1e-6)


def shown(found: Diagnosis, monkeypatch: pytest.MonkeyPatch, **screen: Any) -> list[str]:
    """Return the lines that `elastic-arm diagnose` prints of a diagnosis."""
    console = Console(file=io.StringIO(), highlight=False, no_color=True, **screen)
    monkeypatch.setattr("elastic_arm.cli.diagnosis_printing.out", console)
    print_diagnosis(found)
    return re.sub(r"\x1b\[[\d;]*m", "", console.file.getvalue()).splitlines()  # type: ignore[attr-defined]


def test_causes_are_readable_on_a_narrow_screen(
    two_causes: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On 80 columns no line is longer, and a size as real arms have it stands on one line with
    deviation and unit."""
    offset = {"offset": ParameterEstimate(-0.6656, 0.02628, "Nm")}
    tilt = {
        "x": ParameterEstimate(-0.01668, 0.001152, "rad"),
        "y": ParameterEstimate(-0.007061, 0.001386, "rad"),
    }
    first, second = two_causes.causes
    causes = (
        replace(first, effect="joint_torque_offset", joint="lwr_0_joint", parameters=offset),
        replace(second, effect="base_tilt", joint=None, parameters=tilt),
    )
    found = replace(two_causes, causes=causes)
    lines = shown(found, monkeypatch, width=80, force_terminal=True)
    assert max(map(len, lines)) <= 80
    told = "\n".join(lines)
    for words in (
        "joint_torque_offset +lwr_0_joint +offset -0.666 ± 0.026 Nm",
        "base_tilt +whole arm",
        "x -0.0167 ± 0.0012 rad",
        "y -0.0071 ± 0.0014 rad",
    ):
        assert re.search(words, told), told
    assert "…" not in told


def test_piped_causes_are_a_line_each(
    two_causes: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no screen ends the line, a cause stands on one with all its sizes, and no sentence is
    broken."""
    lines = shown(two_causes, monkeypatch, width=UNLIMITED)
    assert lines[:3] == summary(two_causes)
    first, second = two_causes.causes
    assert lines[:2] == [
        f"explained: {cause_sentence(first, 'mod3')}",
        cause_sentence(second, "mod3"),
    ]
    for cause in two_causes.causes:
        (line,) = [line for line in lines if line.startswith(f"{cause.effect}  ")]
        assert estimates_text(cause.parameters) in line and line.endswith(
            probability_text(cause.confidence)
        )
    assert any(line.startswith("trust in the description: ") for line in lines)


def test_numbers_that_puzzle_are_explained_beside_them(
    two_causes: Diagnosis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cause that alone enlarges the gap, a certain one and a size of two values, on screen and in
    the report."""
    first, *others = two_causes.causes
    change = Change(
        "coulomb_friction", "joint_2", "torque", "Nm", (("a", 6.0, 0.1), ("b", 9.0, 0.1)), 0.99
    )
    causes = (replace(first, shrink=-0.048, confidence=0.9998), *others)
    found = replace(two_causes, causes=causes, changes=(change,))
    page = write_gap_report(tmp_path / "report.html", found).read_text()
    screen = "\n".join(shown(found, monkeypatch, width=UNLIMITED))
    for told in (html.unescape(page), screen):
        assert "-4.8 %" not in told and "only with others" in told
        assert "> 99.9 %" in told
        assert (
            "coulomb friction of joint_2 changed: 6.00 ± 0.10 Nm in a; 9.00 ± 0.10 Nm in b" in told
        )


def test_files_of_an_earlier_diagnosis_do_not_stay(two_causes: Diagnosis, tmp_path: Path) -> None:
    """A folder never holds the arm or the motion of another diagnosis than its diagnosis.json."""
    for name in ("robot.yaml", SEPARATING):
        (tmp_path / name).write_text("old")
    save_diagnosis(two_causes, repaired_robot(ROBOT, two_causes), tmp_path)
    assert not (tmp_path / SEPARATING).exists()
    assert "coulomb_friction" in (tmp_path / "robot.yaml").read_text()


def test_help_says_what_is_written_and_how_it_ends() -> None:
    """`diagnose --help` names the files, the exit status and every option of the contract."""
    words = " ".join(re.sub(r"[│╭╮╰╯─]", " ", run("diagnose", "--help").output).split())
    for word in (
        "diagnosis.json",
        "report.html",
        "robot.yaml",
        SEPARATING,
        "exit status",
        "--validate",
        "--model",
        "--robot",
        "--channels",
        "--with",
        "--refit",
        "--out",
        "--priors",
        "--against",
        "--json",
        "--no-propose",
    ):
        assert word in words


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("a --validate b c", "a --validate b --validate c"),
        ("a b --validate c --out d e", "a b --validate c --out d e"),
        (
            "a --refit --with x y --validate b c",
            "a --refit --with x --with y --validate b --validate c",
        ),
        ("--validate b a", "--validate b a"),
    ],
)
def test_repeatable_options_take_several_values(given: str, meant: str) -> None:
    """`--validate A B` judges on both, as the usage line says; what stands before any argument is
    an argument."""
    assert spelled_out(given.split(), load("diagnose").params) == meant.split()


def test_friction_by_the_recordings_is_drawn_where_the_model_has_it(two_causes: Diagnosis) -> None:
    """Joint 2 has the dry friction that was found; by the recordings, too, it changes its sign with
    the velocity."""
    context = two_causes.context
    assert context is not None
    (row,) = places_with_friction(context)
    sides = context.validate.layout.sides
    side = sides[row // len(two_causes.joints)]
    assert (two_causes.joints[row % len(two_causes.joints)], side) == ("joint_2", "motor")
    w, measured, _ = friction_at(context, row, side)
    fast = np.abs(w) > 0.3 * np.abs(w).max()
    assert np.mean(np.sign(measured[fast]) == np.sign(w[fast])) > 0.95
    assert np.mean(measured[fast] * np.sign(w[fast])) == pytest.approx(6.0, rel=0.1)
    assert "Friction curves" in [section.title for section in sections(two_causes)]


def test_sides_without_a_residual_are_not_drawn(two_causes: Diagnosis, tmp_path: Path) -> None:
    """An arm with one encoder and motor torque has one equation a joint, and no columns of what was
    not recorded."""

    def motor_alone(values: dict[tuple[str, str], float]) -> dict[tuple[str, str], float]:
        return {place: value for place, value in values.items() if place[1] == "motor"}

    def sizes(of: ResidualSizes) -> ResidualSizes:
        return ResidualSizes(motor_alone(of.rmse), motor_alone(of.peak))

    whole = replace(
        two_causes,
        before=sizes(two_causes.before),
        after=sizes(two_causes.after),
        noise=motor_alone(two_causes.noise),
        context=None,
    )
    page = write_gap_report(tmp_path / "report.html", whole).read_text(encoding="utf-8")
    assert shown_sides(whole) == ("motor",) and shown_sides(two_causes) == (
        "link",
        "drive",
        "motor",
    )
    assert "Each joint has one equation" in page and "all terms of (1)" in page
    assert "not recorded" not in page and "link side" not in page


def test_an_angle_about_zero_is_drawn_in_one_piece(two_causes: Diagnosis) -> None:
    """A joint without gears that swings about zero is not cut in two where a turn begins."""
    context = two_causes.context
    joint = replace(context.model.robot.joints[0], transmission=None)
    gearless = SimpleNamespace(model=SimpleNamespace(robot=SimpleNamespace(joints=(joint,))))
    theta = 4.0 * np.pi + 0.5 * np.sin(np.linspace(0.0, 6.0, 200))
    drawn, name = angle_within_turn(two_causes, gearless, 0, theta, "position")
    np.testing.assert_allclose(np.diff(drawn), np.diff(theta), atol=1e-12)
    assert name == "joint angle within a turn [rad]"
