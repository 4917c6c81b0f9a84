"""A diagnosis of two effects: which they are, with their sizes, and how the search found them."""

from elastic_arm.diagnosis import Diagnosis
from elastic_arm.diagnosis.search_words import search_words


def test_two_effects_at_once_are_told_apart(two_causes: Diagnosis) -> None:
    """Dry friction and a transmission error, each at its joint with its size, and nothing else."""
    sizes = {(c.effect, c.joint): c.parameters for c in two_causes.causes}
    assert set(sizes) == {("coulomb_friction", "joint_2"), ("transmission_error", "joint_1")}
    friction, error = sizes["coulomb_friction", "joint_2"], sizes["transmission_error", "joint_1"]
    for found, true in (
        (friction["torque"], 6.0),
        (error["amplitude"], 2e-5),
        (error["phase"], 0.7),
    ):
        assert abs(found.value - true) < 4.0 * found.std
    assert all(cause.confidence > 0.9 for cause in two_causes.causes)


def test_the_search_is_shown_with_its_sets_what_they_lack_and_its_moves(
    two_causes: Diagnosis,
) -> None:
    """Both effects are in the best set, and sets without one are behind; what is left gains
    nothing."""
    assert two_causes.context is not None
    lines = search_words(two_causes.context.explanation, {})
    best = lines[1]
    assert "0.0 nats behind" in best
    assert "coulomb_friction on joint_2" in best and "transmission_error on joint_1" in best
    first = lines.index("moves:")
    gains = [line for line in lines[:first] if "nats  " in line and "behind" not in line]
    lacking = [line for line in gains if "transmission_error on joint_3" in line]
    assert lacking and all(float(line.split()[0]) < 0.0 for line in lacking)
    assert any("+coulomb_friction/joint_2" in line for line in lines[first:])
