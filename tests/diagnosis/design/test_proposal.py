"""A proposed motion as data."""

from __future__ import annotations

from typing import Any

from elastic_arm.diagnosis.design.proposal import PairSeparation, Proposal

PLAY, OFFSET, RIPPLE = ("backlash", "joint_2"), ("encoder_offset", "joint_2"), ("torque_ripple", None)
DECIDED = PairSeparation(PLAY, OFFSET, 0.1, 500.0, True)
OPEN = PairSeparation(PLAY, RIPPLE, 0.1, 2.0, False)
MOTION: Any = object.__new__(type("Motion", (), {"duration": 20.0}))


def test_only_pairs_that_decide_make_a_motion_worth_recording() -> None:
    """A motion that decides one pair of two is worthwhile, for that pair alone."""
    both = Proposal(MOTION, (DECIDED, OPEN), 188)
    assert both.worthwhile and both.decided == {(PLAY, OFFSET)}
    assert not Proposal(MOTION, (OPEN,), 188).worthwhile


def test_without_a_motion_nothing_is_decided() -> None:
    """Where no motion within the limits was found, no pair counts as decided, and no file is named."""
    none = Proposal(None, (DECIDED,), 0, ("no motion",))
    assert not none.worthwhile and none.decided == set()
    written = none.to_dict("motion.yaml")
    assert written["file"] is None and written["duration_s"] is None and written["notes"] == ["no motion"]


def test_pairs_are_written_with_both_log_likelihoods() -> None:
    """A reader sees how far this recording discriminates, and how far the motion is expected to."""
    (pair,) = Proposal(MOTION, (DECIDED,), 188).to_dict("motion.yaml")["pairs"]
    assert pair["log_likelihood"] == {"this_recording": 0.1, "proposed": 500.0}
    assert pair["cause"] == {"effect": "backlash", "joint": "joint_2"} and pair["decides"] is True
