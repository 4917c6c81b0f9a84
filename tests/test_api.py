"""The suite as a Python library: names, effects as text, results, and the notebook."""

import json
from pathlib import Path

import numpy as np
import pytest

import elastic_arm as ea
from elastic_arm.effects.text import parse_laws
from elastic_arm.errors import EffectError, RecordingError

NOTEBOOK = Path(__file__).parents[1] / "examples" / "first_arm.ipynb"
ROBOT = ea.load_robot()


def test_every_name_of_the_package_is_there_and_shown() -> None:
    """What `__all__` names can be had, and completion shows it."""
    assert (
        {"load_robot", "read_recording", "identify", "diagnose", "simulate"}
        < set(ea.__all__)
        <= set(dir(ea))
    )
    assert all(getattr(ea, name) is not None for name in ea.__all__)
    assert Path(ea.__file__).with_name("py.typed").exists()


def test_effects_are_taken_as_text_everywhere() -> None:
    """One text stands for the effect on its joint, or on all of them; what is no effect is refused
    at once."""
    laws = ea.IdentificationSettings(effects="coulomb_friction").laws(ROBOT)
    assert laws == tuple(parse_laws(["coulomb_friction"], ROBOT)) and len(laws) == ROBOT.n
    question = ea.Question(ROBOT, given=["viscous_friction:joint_2"], effects=["coulomb_friction"])
    assert [(i.effect.id, i.joint) for i in question.known] == [("viscous_friction", "joint_2")]
    assert [effect.id for effect in question.candidates] == ["coulomb_friction"]
    with pytest.raises(EffectError, match="coulomb_fiction"):
        ea.Question(ROBOT, given=["coulomb_fiction"])
    with pytest.raises(EffectError, match="3 is not an effect"):
        ea.IdentificationSettings(effects=[3]).laws(ROBOT)  # type: ignore[list-item]


def test_stamps_in_seconds_are_refused() -> None:
    """Times in seconds are no nanoseconds: they are refused with what to do, and whole floats are
    taken."""
    t = np.arange(0.0, 1.0, 0.001)
    with pytest.raises(RecordingError, match=r"as times in seconds do.*1e9"):
        ea.Side(t, position=np.zeros((len(t), 1)))
    assert ea.Side(np.round(1e9 * t), position=np.zeros((len(t), 1))).stamp_ns[1] == 1_000_000


@pytest.mark.nightly
@pytest.mark.slow(20)
def test_the_notebook_runs_and_finds_the_friction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All cells run one after the other; the friction that the arm was given is found, and nothing
    is left then."""
    monkeypatch.chdir(tmp_path)
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    found = names["found"]
    again = names["again"]
    assert isinstance(found, ea.Diagnosis) and isinstance(again, ea.Diagnosis)
    assert [(c.effect, c.joint) for c in found.causes] == [("coulomb_friction", "joint_2")]
    assert again.verdict == "none"
    assert ea.Diagnosis.load("diagnosis.json").to_dict() == found.to_dict()


def test_an_arm_and_a_recording_are_shown_in_a_line() -> None:
    """What Python shows of an arm is its name and joints, of a recording its channels, and not
    their numbers."""
    assert repr(ROBOT) == "<Robot elastic_arm_3: joint_1, joint_2, joint_3>"
    side = ea.Side(np.arange(5) * 10**6, position=np.zeros((5, 3)))
    shown = repr(ea.Recording(ROBOT.joint_names, motor=side, source="run_1"))
    assert shown == "<Recording run_1: joint_1, joint_2, joint_3; 5 samples of motor.position>"
