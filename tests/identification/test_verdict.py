"""What is called well determined."""

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.verdict import natural_scales, relative_std, verdicts
from elastic_arm.robot import load_robot


def test_a_spring_that_noise_has_drawn_to_zero_is_not_called_well_determined() -> None:
    """Its deviation is drawn down with it: it counts beside the estimate, not beside the spring of
    the description."""
    robot = load_robot(None)
    recorded = (frozenset({"q", "theta", "tau_J", "tau_m"}),) * 3
    equations = BaseRegression(
        build_model(robot, "mod3"), recorded, (), robot.joint_names, summed=True
    )
    names = equations.base.names
    spring = names.index("joint_1.K")
    moment = next(k for k, name in enumerate(names) if name.startswith("link_2.mx"))
    Psi = equations.base.T @ equations.nominal
    std = 0.01 * natural_scales(equations)
    assert set(np.array(verdicts(relative_std(equations, Psi, std)))[[spring, moment]]) == {"well"}
    Psi[[spring, moment]] *= 0.012
    found = verdicts(relative_std(equations, Psi, std))
    assert found[spring] == "not"
    assert found[moment] == "well"  # a first moment may be anything, zero included
