"""Recordings that a diagnosis cannot use, or not without a remark: each is named in a line that
says what to do."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from elastic_arm.cli.diagnose import diagnose_command
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.preprocessing import clock_drift, usable
from elastic_arm.errors import DiagnosisError, IdentificationError
from elastic_arm.recording import Recording, write_recording
from tests.helpers.effect_samples import INSTANCES
from tests.helpers.gap_recordings import ROBOT, motions, record

APP = typer.Typer()
APP.command("diagnose")(diagnose_command)


def pair(*effects: str) -> list[Recording]:
    return [record(motion, *effects, seed=k) for k, motion in enumerate(motions())]


@pytest.fixture(scope="module")
def clean() -> list[Recording]:
    return pair()


def with_effort(
    recording: Recording, change: Callable[[np.ndarray], np.ndarray], *sides: str
) -> Recording:
    """Change the torque channels of some sides."""
    changed = {}
    for name in sides:
        side = recording.sides()[name]
        assert side.effort is not None
        changed[name] = replace(side, effort=change(side.effort))
    return replace(recording, **changed)  # type: ignore[arg-type]


def at_rest(recording: Recording) -> Recording:
    sides = {
        n: replace(s, position=0 * s.position, velocity=0 * s.velocity)
        for n, s in recording.sides().items()
    }
    return replace(recording, link=sides["link"], motor=sides["motor"], reference=None)


def some(recording: Recording, rows: slice) -> Recording:
    """Return some samples of each side."""
    sides = {name: side.at(rows) for name, side in recording.measured().items()}
    return replace(recording, link=sides["link"], motor=sides["motor"], reference=None)


def drifting(recording: Recording, rate: float) -> Recording:
    """Stamp the link side by a clock that runs faster by `rate`."""
    assert recording.link is not None
    since = recording.link.stamp_ns - recording.link.stamp_ns[0]
    stamps = recording.link.stamp_ns[0] + np.round(since * (1.0 + rate)).astype(np.int64)
    return replace(recording, link=replace(recording.link, stamp_ns=stamps))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (at_rest, ("contains no motion", "excite")),
        (lambda r: r.between(0.0, 3.0), ("too short", "at least")),
        (
            lambda r: with_effort(r, lambda e: 0 * e, "link", "motor"),
            ("every torque channel", "empty", "Record"),
        ),
    ],
    ids=["no motion", "too short", "torques empty"],
)
def test_unusable_bag_ends_in_one_line_and_status_2(
    spoil: Callable[[Recording], Recording], words: tuple[str, ...], tmp_path: Path
) -> None:
    """No motion, too short, no torque in any channel: one line says what is wrong and what to do,
    and that is all."""
    bag = write_recording(tmp_path / "bag", spoil(record(motions()[0].repeated(2))))
    told = CliRunner().invoke(APP, [str(bag), "--out", str(tmp_path / "out")])
    assert told.exit_code == 2
    (line,) = told.stderr.strip().splitlines()
    assert line.startswith("error: ") and all(word in line for word in words)
    assert not (tmp_path / "out").exists()


def test_one_dead_torque_channel_is_left_out_with_a_remark(clean: list[Recording]) -> None:
    """Joint torques that are 0 throughout were not recorded: the rest is diagnosed, and the result
    says so."""
    dead = [with_effort(r, lambda e: 0 * e, "link") for r in clean]
    found = diagnose([dead[0]], Question(ROBOT, effects=()), [dead[1]])
    assert found.verdict == "none"
    assert any("joint torque" in note and "treated as not recorded" in note for note in found.notes)
    assert found.to_dict()["gap"]["before"]["joint_1"]["drive"] is None


@pytest.mark.parametrize("rate", [1e-5, -1e-4])
def test_clocks_that_drift_apart_are_brought_together_with_a_remark(
    rate: float, clean: list[Recording]
) -> None:
    """Two topics stamped by clocks 10 or 100 us a second apart: stamps are as they were, and the
    figure is said."""
    found, plain = usable(drifting(clean[0], rate), ROBOT), clean[0]
    assert found.link is not None and found.motor is not None and plain.link is not None
    since = found.link.stamp_ns - found.motor.stamp_ns
    assert np.abs(since).max() < 0.1 * abs(rate) * np.ptp(plain.link.stamp_ns)
    (note, *_) = [note for note in found.notes if "drift apart" in note]
    assert float(note.split("drift apart by ")[1].split(" us")[0]) == pytest.approx(
        1e6 * rate, rel=0.05
    )


@pytest.mark.parametrize(
    "effect", ["hysteresis", "transmission_error", "time_delay", "encoder_eccentricity", "backlash"]
)
def test_no_effect_of_the_drive_is_taken_for_a_drift(effect: str) -> None:
    """What bends the deflection is no clock: stamps stay as they are."""
    recording = record(motions()[0], INSTANCES[effect][0])
    assert clock_drift(recording.samples()) is None
    assert usable(recording, ROBOT) == recording


def test_zeros_beside_joints_without_a_torque_are_no_torques(clean: list[Recording]) -> None:
    """Where the torques that there are hold 0 throughout, and the other joints have none, every
    channel is empty."""
    bare = with_effort(
        clean[0],
        lambda effort: np.where([True, False, True], 0.0 * effort, np.nan),
        "link",
        "motor",
    )
    with pytest.raises(DiagnosisError, match="every torque channel"):
        usable(bare, ROBOT)


@pytest.mark.parametrize("count", [5, 30, 300])
def test_a_handful_of_samples_is_too_short_in_words(clean: list[Recording], count: int) -> None:
    """No drift of clocks is looked for in so few, and the answer says what to record."""
    few = [some(recording, slice(2000, 2000 + count)) for recording in clean]
    with pytest.raises((DiagnosisError, IdentificationError), match=r"too short|not sufficient"):
        diagnose([few[0]], Question(ROBOT), [few[1]])


def test_ten_samples_a_second_are_too_few_in_words(clean: list[Recording]) -> None:
    """A stretch that is shorter than the smoother's ends is refused with what it needs."""
    slow = [some(recording, slice(None, None, 50)) for recording in clean]
    with pytest.raises(IdentificationError, match="not sufficient for the smoother"):
        diagnose([slow[0]], Question(ROBOT), [slow[1]])
