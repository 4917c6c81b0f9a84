"""Whether one number of a description is off, or all of them are: on numbers that a recording shows, made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.inference.faults import LargeImperfection
from elastic_arm.diagnosis.inference.final_estimates import FinalEstimates
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import parse
from elastic_arm.effects.equations import ArmEquations
from tests.diagnosis.laws.test_comparison import cogging, compared, sign, speed
from tests.helpers.gap_recordings import ROBOT
from tests.helpers.moved_joints import Moved

WIDTH = 30.0  # of a fault's prior over an ordinary one's
KINDS = ("link_mass", "link_com_x", "link_com_y", "link_com_z", "link_inertia_xx", "link_inertia_yy")


def masses() -> list[Any]:
    """The mass of each link as an effect."""
    equations = ArmEquations(ROBOT, "mod3")
    names = ROBOT.joint_names
    return [feature_of(parse(f"link_inertia_mismatch:{name}:mass=1.5", ROBOT), equations) for name in names]


def odds(off: NDArray[np.float64], precision: NDArray[np.float64]) -> float:
    """Return the odds that all numbers are off, against the first one alone.

    Parameters
    ----------
    off
        (18,) by how much the recording finds each number off, in standard deviations of ordinary priors.
    precision
        (18,) one over the standard deviation with which it does, in the same unit.
    """
    parameters = []
    for feature in masses():
        for kind in KINDS:
            error, wide = (feature, not parameters) if kind == "link_mass" else (None, False)
            width = WIDTH if wide else 1.0
            parameters.append(
                NuisanceParameter(kind, feature.joint, "1", 0.06 * width, 1.0, error=error, widened=width)
            )
    widths = np.array([p.widened for p in parameters])
    library = SimpleNamespace(nuisance=SimpleNamespace(centre=np.zeros(len(parameters))))
    problem = SimpleNamespace(parameters=tuple(parameters), settings=DiagnosisSettings())
    fit: Any = SimpleNamespace(problem=problem, found=SimpleNamespace(library=library))
    found = FinalEstimates(fit, SimpleNamespace(), np.zeros(0), np.zeros(0), ())  # type: ignore[arg-type]
    vars(found)["_without_causes"] = (1.0, np.diag((precision * widths) ** 2), precision**2 * widths * off, 0.0)
    return found.odds_of_crude_description(LargeImperfection(masses()[0], 0.06 * float(off[0]), 0.01, []))


@pytest.mark.parametrize("seed", range(5))
def test_one_number_that_is_far_off_among_ordinary_ones_is_a_fault(seed: int) -> None:
    """At eight standard deviations of its prior, where the others scatter as theirs, it is off by itself."""
    off = np.random.default_rng(seed).standard_normal(18)
    off[0] = 8.0
    assert odds(off, np.full(18, 5.0)) < 0.01


def test_one_number_among_many_that_are_as_far_off_is_none() -> None:
    """Where all numbers are off by five standard deviations, eight of one are no fault of it alone."""
    off = np.resize([5.0, -5.0], 18)
    off[0] = 8.0
    assert odds(off, np.full(18, 5.0)) > 1.0


def test_a_recording_that_hardly_shows_the_others_leaves_a_doubt() -> None:
    """Six standard deviations of one number, nothing known of the others: they may be as far off, or not."""
    off = np.zeros(18)
    off[0] = 6.0
    assert 0.02 < odds(off, np.where(np.arange(18) > 0, 0.1, 5.0)) < 20.0


def test_encoders_have_nothing_to_do_with_the_description() -> None:
    """A zero of an encoder beyond ordinary is nothing that other masses would do."""
    zero = feature_of(parse("encoder_offset:joint_2:offset=0.01", ROBOT), ArmEquations(ROBOT, "mod3"))
    found = FinalEstimates(SimpleNamespace(), SimpleNamespace(), np.zeros(0), np.zeros(0), ())  # type: ignore[arg-type]
    assert found.odds_of_crude_description(LargeImperfection(zero, 0.01, 1e-4, [])) == 0.0


@pytest.mark.parametrize(("shown", "crude"), [(30.0, False), (2.0, True)])
def test_a_payload_is_weighed_against_a_crude_description(shown: float, crude: bool) -> None:
    """What all numbers of the links explain at eight times ordinary errors is no payload, what they cannot is one."""
    parameters = tuple(NuisanceParameter(kind, "joint_1", "1", 0.06, 1.0) for kind in KINDS)
    problem = SimpleNamespace(parameters=parameters, settings=DiagnosisSettings())
    library = SimpleNamespace(nuisance=SimpleNamespace(centre=np.zeros(6)), sets=[SimpleNamespace(freedom=5000.0)] * 2)
    fit: Any = SimpleNamespace(problem=problem, found=SimpleNamespace(library=library))
    payload: Any = SimpleNamespace(key=("payload", "joint_1", ()))
    free: Any = SimpleNamespace(feature=payload, free=np.full(4, True))
    found = FinalEstimates(fit, SimpleNamespace(), np.zeros(0), np.zeros(0), (free,))  # type: ignore[arg-type]
    precision = np.full(6, 25.0)
    # With the payload the numbers are as described; without it they are off by so many standard deviations.
    beside = (1.0, np.diag(precision), np.zeros(6), 0.0)
    off = np.full(6, 6.0)
    left = float(precision @ off**2) + shown**2
    vars(found)["_without_causes"] = beside
    object.__setattr__(found, "_normal_equations", lambda key: (1.0, np.diag(precision), precision * off, left))
    assert (found.odds_of_crude_description_against(payload) > 1.0) == crude


def needed(unexplained: float, *, friction: bool = False) -> set[int]:
    """Return which of viscous and dry friction of motor 2 are needed, of an arm that has the first, beside a torque.

    Parameters
    ----------
    unexplained
        Size of the torque.
    friction
        Whether they count as friction.
    """
    torque = lambda s: 2.0 * speed(s) + unexplained * cogging(s)  # noqa: E731
    comparison, selected = compared([Moved(k, torque, {"motor": 1.0}) for k in (1, 2)], speed, sign)
    for candidate in selected:
        vars(candidate.feature)["effect"] = SimpleNamespace(id=candidate.feature.key[0], is_friction=friction)
    problem = SimpleNamespace(settings=DiagnosisSettings())
    fit: Any = SimpleNamespace(found=SimpleNamespace(library=comparison._library), selected=selected, problem=problem)
    found = FinalEstimates(fit, SimpleNamespace(), np.zeros(0), np.zeros(0), ())  # type: ignore[arg-type]
    return found.needed()


def test_where_much_is_unexplained_the_likelihood_keeps_a_cause() -> None:
    """Beside a large torque that no effect states viscous friction is needed and dry friction, which is not there, not.

    Without it what is certain is a matter of standard deviations alone.
    """
    assert needed(5.0) == {0}
    assert needed(0.0) == set()


def test_which_friction_a_joint_has_is_a_matter_of_its_deviations() -> None:
    """Of two frictions of one joint none is needed: how uncertain they are is no other joint's doing."""
    assert needed(5.0, friction=True) == set()
