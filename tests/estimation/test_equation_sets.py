"""Which equations the recorded channels allow, and how they follow from the residuals link, drive
and motor."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.equation_sets import SIDES, EquationSet

CHANNELS = ("q", "theta", "tau_J", "tau_m")
ALL = frozenset(CHANNELS)


def subsets(*needed: str) -> list[frozenset[str]]:
    """Every set of channels that holds the needed ones."""
    rest = [c for c in CHANNELS if c not in needed]
    return [frozenset(needed) | set(c) for k in range(len(rest) + 1) for c in combinations(rest, k)]


@pytest.mark.parametrize(
    "recorded", [s for s in subsets("q", "theta") if s & {"tau_J", "tau_m"}], ids=sorted
)
def test_with_both_encoders_direct_and_independent_equations_span_the_same(
    recorded: frozenset[str],
) -> None:
    """The two bases hold the same information: their rows span one space."""
    direct, independent = (
        make(recorded, 2).transform for make in (EquationSet.direct, EquationSet.independent)
    )
    rank = np.linalg.matrix_rank
    assert rank(direct) == len(direct) == rank(independent) == len(independent)
    assert rank(np.vstack([direct, independent])) == len(direct)


@pytest.mark.parametrize("recorded", subsets("q", "theta", "tau_m"), ids=sorted)
def test_independent_equations_share_no_torque_sensor(recorded: frozenset[str]) -> None:
    """Every torque channel stands in one equation, and in no other."""
    found = EquationSet.independent(recorded, 1)
    torques = [found.equation(side).torque for side in found.sides]
    held = [torque for torque in torques if torque]
    assert sorted(held) == sorted(recorded & {"tau_J", "tau_m"})


@pytest.mark.parametrize(
    "recorded", [s for s in subsets("q", "theta") if s & {"tau_J", "tau_m"}], ids=sorted
)
def test_a_missing_torque_cancels(recorded: frozenset[str]) -> None:
    """What is in a channel that was not recorded has no influence on the usable rows."""
    of_torque = {"tau_J": (1.0, 1.0, -1.0), "tau_m": (0.0, 0.0, 1.0)}
    found = EquationSet.direct(recorded, 3)
    for missing in set(of_torque) - recorded:
        full = np.repeat(of_torque[missing], 3)
        np.testing.assert_array_equal(found.transform @ full, 0.0)


def test_rows_come_equation_by_equation() -> None:
    """With all channels the direct set is the identity in the order link, drive, motor."""
    found = EquationSet.direct(ALL, 3)
    assert found.sides == SIDES and found.rows == 9
    np.testing.assert_array_equal(found.transform, np.eye(9))
    columns = np.random.default_rng(0).standard_normal((5, 9, 2))
    np.testing.assert_array_equal(found.combine(columns), columns)


def test_joints_may_have_channels_of_their_own() -> None:
    """A joint without a torque sensor loses its drive equation, and its link equation takes the
    drive's law."""
    found = EquationSet.direct([ALL, ALL - {"tau_J"}], 2)
    assert [(equation.name, joint) for equation, joint in found.entries] == [
        ("link", 0),
        ("link", 1),
        ("drive", 0),
        ("motor", 0),
        ("motor", 1),
    ]
    np.testing.assert_array_equal(found.transform[1], [0, 1, 0, -1, 0, 0])
    np.testing.assert_array_equal(found.transform[4], [0, 0, 0, 1, 0, 1])


@pytest.mark.parametrize(
    ("recorded", "elastic", "sides"),
    [
        ({"q", "tau_J", "tau_m"}, True, ("link", "motor")),
        ({"q", "tau_J", "tau_m"}, False, ("link", "motor")),
        ({"theta", "tau_J", "tau_m"}, False, ("link", "motor")),
        ({"theta", "tau_J"}, False, ("link",)),
        ({"q", "tau_m"}, False, ("motor",)),
    ],
)
def test_motor_torque_gives_its_equation_without_motor_angles(
    recorded: set[str], elastic: bool, sides: tuple[str, ...]
) -> None:
    """Beside joint torques the link's angle is enough for the motor's equation, and a rigid arm has
    one angle."""
    assert EquationSet.direct(recorded, 2, elastic=elastic).sides == sides


@pytest.mark.parametrize(
    "recorded, word",
    [({"tau_m"}, "positions"), ({"q", "theta"}, "torque"), ({"theta", "tau_J"}, "no equation")],
)
def test_channels_that_allow_no_equation_are_named(recorded: set[str], word: str) -> None:
    """The error names what is missing."""
    with pytest.raises(IdentificationError, match=word):
        EquationSet.direct(recorded, 2)


@pytest.mark.parametrize("make", [EquationSet.direct, EquationSet.independent])
def test_a_joint_without_a_torque_has_no_equation(make: Callable[..., EquationSet]) -> None:
    """Its rows are void where the others have one; both encoders leave it that of its link."""
    found = make([{"q", "tau_J"}, {"q"}], 2).even()
    assert found.live.tolist() == [True, False] and found.without_rows == (1,)
    np.testing.assert_array_equal(found.transform[1], 0.0)
    wound = make([{"q", "theta", "tau_m"}, {"q", "theta"}], 2).even()
    assert wound.without_rows == ()
    np.testing.assert_array_equal(wound.live.reshape(2, 2), [[True, True], [True, False]])
    with pytest.raises(IdentificationError, match="no torque was recorded"):
        make([{"q"}, {"q", "theta"}], 2)
