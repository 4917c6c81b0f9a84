"""What `diagnose --explain` prints of a search."""

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.search_words import search_words
from tests.helpers.gap_recordings import ROBOT, motions, record


def test_the_search_is_shown_with_its_sets_what_they_lack_and_its_moves() -> None:
    """The friction is in the best set, and the set without it is behind; what is left gains
    nothing."""
    text = "coulomb_friction:joint_2:torque=6"
    fitted, judged = (record(motion, text, seed=k) for k, motion in enumerate(motions()))
    effects = ["coulomb_friction", "payload"]
    found = diagnose([fitted], Question(ROBOT, effects=effects), [judged])
    assert found.context is not None
    lines = search_words(found.context.explanation)
    best = lines[1]
    assert "0.0 nats behind" in best and "coulomb_friction on joint_2" in best
    first = lines.index("moves:")
    lacking = [line for line in lines[:first] if "payload" in line and "nats  " in line]
    assert lacking and all(float(line.split()[0]) < 0.0 for line in lacking if "behind" not in line)
    assert any("+coulomb_friction/joint_2" in line for line in lines[first:])
