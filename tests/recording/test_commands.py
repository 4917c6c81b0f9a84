"""Whether recorded commands are what an arm followed."""

import re
from dataclasses import replace

import numpy as np

from elastic_arm.recording import Recording, Side
from elastic_arm.recording.inspection.check import looked_through, misread
from tests.helpers.servo_arms import recorded, servo_arm

STAMPS = np.arange(600) * 20_000_000


def motion(late: float = 0.0, seed: int = 0, ratio: float = 1.0) -> np.ndarray:
    """(600, 2) rad."""
    rng = np.random.default_rng(seed)
    t = STAMPS * 1e-9 - late
    phases = rng.uniform(0, 6, (4, 2))
    return ratio * sum(
        np.sin(np.outer(t, [w, 1.3 * w]) + p)
        for w, p in zip((1.0, 2.2, 3.1, 4.7), phases, strict=True)
    )


def recording(position: np.ndarray, command: np.ndarray) -> Recording:
    return Recording(
        ("a", "b"), link=Side(STAMPS, position=position), reference=Side(STAMPS, position=command)
    )


def found(position: np.ndarray, command: np.ndarray) -> dict[str, str]:
    findings = looked_through(recording(position, command))
    return {one.code: one.message for one in findings if one.code not in ("reading", "no_torque")}


def test_lag_and_rates_of_commands_are_stated() -> None:
    """An arm that follows is 60 ms behind, at its commands' size; nothing is wrong."""
    seen = found(motion(0.06) + 1e-3 * np.random.default_rng(1).normal(size=(600, 2)), motion())
    assert set(seen) == {"commands"}
    assert (
        "lag the commands by 60 ms" in seen["commands"]
        and "commands come at 50 Hz, positions at 50 Hz" in seen["commands"]
    )


def test_commands_of_something_else_are_named() -> None:
    """Another motion, mostly, a copy of the positions, degrees for radians and positions that come
    first are warned of."""
    noise = 1e-3 * np.random.default_rng(1).normal(size=(600, 2))
    others = [found(motion(0.06) + noise, motion(seed=seed)) for seed in range(5, 15)]
    assert sum("not_followed" in seen for seen in others) >= 8
    assert "not_followed" in found(motion(0.06) + noise, motion()[:, ::-1])
    assert "copied_command" in found(motion(), motion())
    assert "command_unit" in found(motion(0.06, ratio=0.0175) + 0.01 * noise, motion())
    assert "early" in found(motion(-0.1) + noise, motion())


def test_a_weak_servo_follows() -> None:
    """One that falls short under load, with half of its swing beside the command, is not blamed."""
    command = motion()
    sag = np.cos(command[:, ::-1] - 0.3)
    weak = motion(0.06) + np.array([0.0, 1.5]) * (sag - sag.mean(axis=0))
    seen = found(weak + 1e-3 * np.random.default_rng(1).normal(size=(600, 2)), command)
    largest = re.search(r"deviations .* to (\S+) % of", seen.pop("commands"))
    assert not seen and largest is not None and 50.0 < float(largest[1]) < 70.0


def test_a_joint_of_several_is_named() -> None:
    """Where one joint does not follow, it alone is."""
    position = motion(0.06) + 1e-3 * np.random.default_rng(1).normal(size=(600, 2))
    command = motion()
    command[:, 1] = motion(seed=9)[:, 1]
    assert found(position, command)["not_followed"].startswith("b did not follow")


def test_a_command_that_never_changes_was_not_recorded() -> None:
    """Of a joint that moves, it is named; one that is held, and gives way a little, is not
    blamed."""
    noise = 1e-3 * np.random.default_rng(1).normal(size=(600, 2))
    position = motion(0.06) + noise
    command = motion()
    command[:, 1] = 0.3
    seen = found(position, command)
    assert seen.pop("constant_command").startswith("command of b is constant")
    assert set(seen) == {"commands"}
    position[:, 1] = 0.3 + 4.0 * noise[:, 1]
    assert set(found(position, command)) == {"commands"}


def test_recordings_without_commands_are_not_looked_at() -> None:
    """Nothing is said of commands that are not there."""
    alone = replace(recording(motion(), motion(0.1)), reference=None)
    assert not {"commands", "not_followed"} & {one.code for one in looked_through(alone)}


def test_commands_that_are_the_next_positions_are_misread() -> None:
    """No torque is made of what no drive received: a diagnosis seeks no cause and writes no
    file."""
    arm = servo_arm().robot
    given = recorded(servo_arm(), 50.0, 12)
    assert misread([given], arm, explained=True) is None
    position = given.link.position
    copied = replace(given.reference, position=np.vstack([position[1:], position[-1:]]))
    words = misread([replace(given, reference=copied)], arm, explained=True)
    assert words is not None and "positions of 1 sample later" in words
