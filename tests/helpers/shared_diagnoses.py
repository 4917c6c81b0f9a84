"""Diagnoses that tests of reports, predictions and next motions share: each is made once."""

from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from typer.testing import Result

from elastic_arm.cli import diagnose as command
from elastic_arm.diagnosis import Diagnosis, Question, diagnose, follow_up
from elastic_arm.effects import EFFECTS
from elastic_arm.recording import write_recording
from tests.helpers.candidates import candidates
from tests.helpers.command_line import run
from tests.helpers.gap_recordings import ROBOT, gentle, motions, record

FRICTION = "coulomb_friction:joint_2:torque=6"
ERROR = "transmission_error:joint_1:amplitude=2e-5,phase=0.7"
# Loaded one way throughout, play in a drive is an offset between its two encoders; larger than an
# ordinary one, which would be no cause.
PLAY = "backlash:joint_2:half_gap=4e-5"
# Hz: at half of it, angles are not known well enough to tell what the small error of joint 1 does.
RATE = 1000.0


class Commanded(NamedTuple):
    """What `elastic-arm diagnose` did: the folder of its bags and results, what it printed, and the
    diagnosis that it wrote."""

    folder: Path
    told: Result
    found: Diagnosis


def with_two_causes() -> Diagnosis:
    """Dry friction and a transmission error, asked for alone, and what follows a diagnosis."""
    recordings = [
        record(motion, FRICTION, ERROR, seed=k, rate=RATE) for k, motion in enumerate(motions())
    ]
    question = Question(ROBOT, effects=(EFFECTS["coulomb_friction"], EFFECTS["transmission_error"]))
    found = diagnose([recordings[0]], question, [recordings[1]])
    return follow_up(found, rng=np.random.default_rng(0))


def without_cause() -> Diagnosis:
    """A clean arm, and no effect to choose."""
    recordings = [record(motion, seed=k, rate=RATE) for k, motion in enumerate(motions())]
    return diagnose([recordings[0]], Question(ROBOT, effects=()), [recordings[1]])


def with_play(folder: Path) -> Commanded:
    """Play that cannot be told from an offset, by the command, with all files that it can write."""
    for k in (1, 2):
        write_recording(folder / f"bag_{k}", record(gentle(k), PLAY, seed=k))
    bags = (folder / "bag_1", "--validate", folder / "bag_2")
    files = ("--csv", "--mcap", folder / "residuals")
    saved_by = mock.patch.object(command, "save_diagnosis", wraps=command.save_diagnosis)
    with candidates(command, "backlash", "encoder_offset"), saved_by as saved:
        told = run("diagnose", *bags, "--out", folder / "diagnosis", *files)
    assert told.exit_code == 0, told.output
    return Commanded(folder, told, saved.call_args.args[0])
