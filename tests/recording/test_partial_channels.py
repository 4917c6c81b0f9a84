"""Channels that only some joints have: NaN for the others, from the mapping to the samples and back
from a bag."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side, load_channels, read_recording, write_recording
from elastic_arm.recording.inspection.outliers import find_outliers
from tests.helpers.bags import JOINT_STATE, imported, joint_state, stamps, write_foreign

N = 400
JOINTS = ("a", "b", "c")
ARM = ("joint_1", "joint_2", "joint_3")
STAMPS = np.arange(N, dtype=np.int64) * 4_000_000


@pytest.fixture
def angles() -> np.ndarray:
    t = 1e-9 * STAMPS
    return np.stack([np.sin(t), np.cos(2 * t), t], axis=1)


@pytest.fixture
def partial(angles: np.ndarray) -> Recording:
    """Motor angles and torques of three joints, link angles of the first and last."""
    link = angles + 1e-4
    link[:, 1] = np.nan
    return Recording(JOINTS, Side(STAMPS, link), Side(STAMPS, angles, effort=10 * angles))


def test_a_joint_without_an_encoder_takes_the_angle_of_its_other_side(
    partial: Recording, angles: np.ndarray
) -> None:
    """Samples hold a number for every joint, and state which of them no sensor gave."""
    samples = partial.samples()
    assert samples.lacking == {("q", 1)}
    np.testing.assert_array_equal(samples.q, angles + np.array([1e-4, 0.0, 1e-4]))


def test_a_bag_keeps_which_joints_have_a_channel(partial: Recording, tmp_path: Path) -> None:
    """What is written comes back, with a note on the joint without the channel; no outlier is found
    in it."""
    write_recording(tmp_path / "bag", partial)
    found = read_recording(tmp_path / "bag")
    np.testing.assert_array_equal(found.link.position, partial.link.position)
    assert any("position is missing for b" in note for note in found.notes)
    assert not find_outliers(found)


def test_sides_stamped_apart_are_joined(partial: Recording, angles: np.ndarray) -> None:
    """Link angles of some joints are interpolated to the stamps of the motors."""
    shifted = Recording(JOINTS, Side(STAMPS + 1_000_000, partial.link.position), partial.motor)
    samples = shifted.samples()
    assert samples.q is not None and samples.theta is not None and samples.lacking == {("q", 1)}
    assert np.isfinite(samples.q).all()
    np.testing.assert_array_equal(samples.q[:, 1], samples.theta[:, 1])


@pytest.mark.parametrize("apart", [False, True])
def test_a_joint_that_appears_later_is_said_to(tmp_path: Path, apart: bool) -> None:
    """From then on all joints are read; how much was left out until then, and for which joint, is a
    note."""
    messages = []
    for k, stamp in enumerate(stamps(400).tolist()):
        kinds = [ARM] if k >= 100 and not apart else [ARM[:2], *([ARM[2:]] if k >= 100 else [])]
        for topic in ("/joint_states", "/motor_states"):
            for names in kinds:
                at = stamp + 200_000 * (names[0] == ARM[2])
                numbers = [np.sin(0.01 * k)] * len(names)
                messages.append(
                    (topic, JOINT_STATE, at, joint_state(at, names, numbers, numbers, numbers))
                )
    found = read_recording(write_foreign(tmp_path / "bag", messages))
    assert found.motor is not None and len(found.motor) == pytest.approx(300, abs=1)
    said = (
        "101 samples outside of its time range are skipped"
        if apart
        else "100 messages on /motor_states without joint_3"
    )
    assert any(said in note for note in found.notes), found.notes


def test_a_mapping_of_arrays_names_the_joints_of_a_channel(
    tmp_path: Path, angles: np.ndarray
) -> None:
    """Columns and scales are given for the joints that have the channel."""
    np.savez(tmp_path / "run.npz", theta=angles, q=angles[:, [0, 2]], tau=angles)
    q = {"key": "q", "joints": ["a", "c"], "unit": "rad", "sign": [1, -1]}
    motor = {"position": {"key": "theta", "unit": "rad"}, "effort": {"key": "tau", "unit": "Nm"}}
    found = imported(tmp_path / "run.npz", JOINTS, 250.0, link={"position": q}, motor=motor)
    assert np.isnan(found.link.position[:, 1]).all()
    np.testing.assert_allclose(found.link.position[:, [0, 2]], angles[:, [0, 2]] * [1.0, -1.0])
    with pytest.raises(RecordingError, match="unknown joint d"):
        imported(
            tmp_path / "run.npz",
            JOINTS,
            250.0,
            link={"position": {**q, "joints": ["a", "d"]}},
            motor=motor,
        )


def test_a_channel_map_may_leave_a_channel_out_at_some_joints(
    partial: Recording, tmp_path: Path
) -> None:
    """Each joint of the map has the channels that it has in the bag."""
    write_recording(tmp_path / "bag", partial)
    motor = {channel: {"topic": "/motor_states"} for channel in ("position", "effort")}
    link = {"position": {"topic": "/joint_states"}}
    joints = {
        "a": {"link": link, "motor": motor},
        "b": {"motor": motor},
        "c": {"link": link, "motor": motor},
    }
    (tmp_path / "channels.yaml").write_text(yaml.safe_dump({"joints": joints}))
    found = read_recording(tmp_path / "bag", load_channels(tmp_path / "channels.yaml"))
    assert found.samples().lacking == {("q", 1)}


def test_a_single_number_that_is_none_is_still_refused(partial: Recording, tmp_path: Path) -> None:
    """NaN in some samples is a damaged channel, not one that a joint lacks."""
    partial.link.position[7, 0] = np.nan
    write_recording(tmp_path / "bag", partial)
    with pytest.raises(RecordingError, match="position of a is nan"):
        read_recording(tmp_path / "bag")
