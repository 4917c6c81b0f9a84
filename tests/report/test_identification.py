"""The page of an identification."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from elastic_arm.identification import IdentificationSettings, identify_with, parse_laws
from elastic_arm.report.html import Figure, Table
from elastic_arm.report.identification import residuals, sections, sentence
from tests.helpers.gap_recordings import ROBOT, motions, record


@pytest.mark.parametrize(
    ("note", "shown"),
    [
        ("the fit ends early", "The fit ends early."),
        ("robot.yaml has the laws as described", "robot.yaml has the laws as described."),
        ("run_2 is predicted worse", "run_2 is predicted worse."),
        ("run: left out as outliers: 1 sample.", "run: left out as outliers: 1 sample."),
    ],
)
def test_names_keep_their_letters_in_notes(note: str, shown: str) -> None:
    """A note becomes a sentence, and the name of a file or recording that it begins with stays as
    it is."""
    assert sentence(note) == shown


@pytest.fixture(scope="module")
def fitted() -> tuple[Any, ...]:
    """A fit, judged on another recording."""
    recordings = [
        record(motion, "coulomb_friction:joint_2:torque=14", seed=k)
        for k, motion in enumerate(motions())
    ]
    settings = IdentificationSettings(
        "mod3", parse_laws(["coulomb_friction"], ROBOT), consistent=False
    )
    return identify_with(recordings[:1], ROBOT, settings, validate=recordings[1:])


def test_instants_at_which_a_joint_sticks_are_gaps_in_the_figures(fitted: tuple[Any, ...]) -> None:
    """They are left out of the fit, and no residual as large as the motor's torque is drawn
    there."""
    result, identifier, motion, _ = fitted
    stuck = np.zeros((len(motion), 3), dtype=bool)
    stuck[1000:1500, 1] = True
    motion = replace(motion, stuck=stuck)
    link, motor, drive = (
        np.asarray(line.get_ydata())
        for line in residuals(identifier.equations, motion, result).axes[1].get_lines()
    )
    assert np.isnan(motor).any() and not np.isnan(np.concatenate([link, drive])).any()
    assert np.nanmax(np.abs(motor)) < 20.0 < np.abs(motion.tau_m[stuck]).max()
    figures = [
        b
        for part in sections(result, identifier.equations, motion)
        for b in part.blocks
        if isinstance(b, Figure)
    ]
    assert sum("while a joint sticks" in figure.caption for figure in figures) == 2


def test_combinations_go_by_their_first_term_and_friction_comes_first(
    fitted: tuple[Any, ...],
) -> None:
    """The report lists friction before base parameters, these by short names, and what they stand
    for further down."""
    result, *_ = fitted
    shown = sections(result)
    laws, base, full = (next(b for b in part.blocks if isinstance(b, Table)) for part in shown[1:4])
    assert [row[0] for row in laws.rows] == [
        f"coulomb_friction:joint_{k}.torque" for k in (1, 2, 3)
    ]
    assert "link_2.mx + 5 terms" in [row[0] for row in base.rows]
    assert dict(full.rows)["link_2.mx + 5 terms"].startswith(
        "link_2.mx - 0.75 link_2.m - 0.75 link_3.m"
    )
    assert "that of the identified arm up to" in result.summary()[1]
