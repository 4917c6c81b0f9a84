"""The functions of docs/architecture.md, "Interfaces", called with what they are not for."""

from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.dynamics import build_model
from elastic_arm.errors import ElasticArmError
from elastic_arm.identification import identify
from elastic_arm.recording import Recording, Side, write_recording
from elastic_arm.robot import load_robot
from elastic_arm.simulation import simulate

RECORDING = Recording(
    ("joint_1", "joint_2", "joint_3"),
    link=Side(np.arange(100) * 10**6, position=np.zeros((100, 3))),
)
ROBOT = load_robot()
MISTAKEN = {
    "identify, recordings": lambda given: identify(given, ROBOT),
    "identify, one of several": lambda given: identify([RECORDING, given], ROBOT),
    "identify, robot": lambda given: identify(RECORDING, given),
    "identify, validate": lambda given: identify(RECORDING, ROBOT, validate=[given]),
    "diagnose, recordings": lambda given: diagnose(given, Question(ROBOT)),
    "diagnose, question": lambda given: diagnose([RECORDING], given),
    "question, robot": Question,
    "simulate, robot": lambda given: simulate(given, None),
    "simulate, trajectory": lambda given: simulate(ROBOT, given),
    "write_recording": lambda given: write_recording("nowhere", given),
    "build_model": build_model,
}


@pytest.mark.parametrize("call", MISTAKEN)
@pytest.mark.parametrize(
    "given",
    [None, 5, "arm.yaml", b"arm", np.zeros(3)],
    ids=["None", "int", "text", "bytes", "array"],
)
def test_an_argument_of_another_kind_is_refused_at_the_entrance(call: str, given: Any) -> None:
    """In one line that says what was given, not by an error from deep inside."""
    with pytest.raises(
        ElasticArmError,
        match=r"(is None|is of type \w+)(, not a \w+|, which is not a motion)\. Give ",
    ):
        MISTAKEN[call](given)


@pytest.mark.parametrize("given", [5, b"arm", []])
def test_a_path_of_another_kind_is_refused_at_the_entrance(given: Any) -> None:
    """None stands for the arm of the package."""
    with pytest.raises(ElasticArmError, match="path is of type"):
        load_robot(given)
    with pytest.raises(ElasticArmError, match="path is of type"):
        write_recording(given, RECORDING)
