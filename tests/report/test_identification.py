"""The page of an identification."""

from __future__ import annotations

import pytest

from elastic_arm.report.identification import sentence


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
    """A note becomes a sentence, and the name of a file or recording that it begins with stays as it is."""
    assert sentence(note) == shown
