"""Absurd numbers in a stream of samples."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.estimation.resampling import part
from elastic_arm.identification import Identification, identifier_of
from elastic_arm.nodes.support.screening import StreamScreen
from elastic_arm.recording import Samples, read_recording, write_recording
from elastic_arm.robot import load_robot
from tests.helpers.ros_graph import Graph

BATCH = 100


@pytest.fixture(scope="module")
def samples() -> Samples:
    return read_recording(Path(__file__).parents[2] / "bags" / "excitation").samples()


def batches(samples: Samples) -> list[Samples]:
    return [part(samples, slice(k, k + BATCH)) for k in range(0, len(samples), BATCH)]


def spoiled(samples: Samples, channel: str, value: float, rows: list[int]) -> Samples:
    """Set samples of joint 2 to a value."""
    values = getattr(samples, channel).copy()
    values[rows, 1] = value
    return replace(samples, **{channel: values})


def test_motion_passes_as_it_is(samples: Samples) -> None:
    """Rest, motion and noise lose no sample, and batches are handed on untouched."""
    screen = StreamScreen()
    assert all(screen.take(batch) is batch for batch in batches(samples))
    assert screen.left_out == 0


def test_an_arm_that_begins_to_move_passes(samples: Samples) -> None:
    """After a minute of rest the first motion is no outlier."""
    screen = StreamScreen()
    still = part(samples, np.zeros(BATCH, dtype=np.intp))
    for _ in range(600):
        screen.take(still)
    moving = part(samples, slice(len(samples) // 2, len(samples) // 2 + BATCH))
    assert screen.take(moving) is moving


@pytest.mark.parametrize(
    ("channel", "value"),
    [("q", 1e200), ("theta", -1.7e308), ("tau_m", 1e6), ("tau_J", 1.7e308), ("dq", -1e5)],
)
@pytest.mark.parametrize("rows", [[3], [4000], [4000, 4001, 4002, 7000]])
def test_absurd_samples_are_left_out_and_counted(
    samples: Samples, channel: str, value: float, rows: list[int]
) -> None:
    """In the first batch or later, alone or in a row: exactly these."""
    screen = StreamScreen()
    kept = [screen.take(batch) for batch in batches(spoiled(samples, channel, value, rows))]
    assert screen.left_out == len(rows)
    np.testing.assert_array_equal(
        np.concatenate([k.stamp_ns for k in kept]), np.delete(samples.stamp_ns, rows)
    )


def test_numbers_of_no_arm_are_left_out_from_the_first_sample_on(samples: Samples) -> None:
    """A whole batch of 1e200 rad, before any other is known, is no range that later ones are judged
    by."""
    screen = StreamScreen()
    absurd = replace(samples, q=samples.q * 0.0 + 1e200)
    assert len(screen.take(part(absurd, slice(0, BATCH)))) == 0
    assert all(screen.take(batch) is batch for batch in batches(samples))
    assert screen.left_out == BATCH


def test_an_estimate_survives_an_absurd_sample(samples: Samples) -> None:
    """One sample of 1e6 Nm in the stream moves no parameter by more than a tenth of its
    deviation."""
    sound, screened = (identifier_of(load_robot(None)) for _ in range(2))
    screen = StreamScreen()
    for batch, bad in zip(
        batches(samples), batches(spoiled(samples, "tau_m", 1e6, [4000])), strict=True
    ):
        sound.add(batch)
        screened.add(screen.take(bad))
    one = sound.estimate()
    other = screened.estimate()
    assert np.abs((one.Psi_base - other.Psi_base) / one.std).max() < 0.1


@pytest.mark.graph
def test_the_identifier_reports_what_it_leaves_out(tmp_path: Path, graph: Graph) -> None:
    """One sample of 1e6 Nm on the graph is counted on /diagnostics, and parameters are determined
    all the same."""
    recording = read_recording(Path(__file__).parents[2] / "bags" / "excitation")
    effort = recording.motor.effort.copy()
    effort[4000, 1] = 1e6
    bag = write_recording(
        tmp_path / "spoiled", replace(recording, motor=replace(recording.motor, effort=effort))
    )
    status = graph.status("identifier")
    identifier = graph.start("identifier", save_to=tmp_path / "online", save_at_exit=True)
    replayer = graph.start(
        "replayer", bag=bag, topics="['/joint_states', '/motor_states']", rate=4.0
    )
    graph.until(
        lambda: "1 samples contain implausible numbers" in status.get("said", ""), "it is reported"
    )
    graph.until(lambda: replayer.process.poll() is not None, "the bag ends")
    assert identifier.stop() == 0
    found = Identification.load(tmp_path / "online" / "identification.json")
    assert sum(estimate.verdict == "well" for estimate in found.estimates) > 10
