"""All decision parameters of the diagnosis, each with unit and source: priors and bounds of the
search.

The result is the most probable set under these priors (:mod:`.posterior`). A file can state the
ordinary deviations of a description's numbers (:func:`read_priors`); the priors of sensors are in
the files of their effects.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from elastic_arm.errors import DiagnosisError
from elastic_arm.input_files import Number, explain, read_fields


class Trust(NamedTuple):
    """A degree of trust in the description and the sensors of an arm."""

    factor: float  # on the standard deviations of the numbers
    prior: float  # prior probability
    coloured: float  # prior odds that the noise of a place has a spectrum of its own
    means: str  # what its numbers are taken for, in words


# "as measured" means a simulation, "as calibrated" an identified arm, "as built" drawings and
# catalogues; convention.
TRUST = {
    "as measured": Trust(1e-5, 0.3, 1e-3, "exact, as in a simulation"),
    "as calibrated": Trust(0.2, 0.3, 0.1, "off by a fifth of ordinary deviations"),
    "as built": Trust(1.0, 0.3, 0.1, "off by ordinary deviations"),
    "rough": Trust(4.0, 0.1, 0.1, "off by four times ordinary deviations"),
}
# Common scale of the zeros and drifts of an arm's torque channels, with its probability: the
# sensors have one make and the same temperature. Twice as large is half as probable.
ZEROS = {1.0: 8 / 15, 2.0: 4 / 15, 4.0: 2 / 15, 8.0: 1 / 15}


# trust at which a search starts
MEASURED = "as measured"
BUILT = "as built"


class Assumed(NamedTuple):
    """Assumptions that all priors of an arm share."""

    trust: str  # key of :data:`TRUST`
    zeros: float = 1.0  # key of :data:`ZEROS`


AS_MEASURED = Assumed(MEASURED)
AS_BUILT = Assumed(BUILT)
# Prior odds that a drive has friction that its description does not state; not with the trust
# `as measured`, a simulation.
USUAL = 9.0
# prior odds that an effect acts or a number is far off: one false cause in a hundred sound arms
ODDS = 1e-2
# odds of a nonparametric law over those of an effect: the catalogue covers most of what arms have
FORMLESS = 1e-3
# shares of the range of a size: effects have all sizes
SCALES = np.array([1.0, 0.1, 0.01, 1e-3, 1e-4])
# standard deviation of a far-off number, in ordinary ones: almost no prior; convention
WIDE = 30.0
# relative standard deviation of a stated effect: friction changes with temperature and wear
STATED = 0.3
# Nm, of nonparametric laws, for joints of every kind
SIZES = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
LEFT = 0.1  # share of its own gap that a place may keep (contract)
ZERO_AS_MOUNTED = (
    1e-3  # rad, of a link encoder that was never compared with the motor's under a known torque
)
# Shares of a joint's largest torque.
OFFSET_SHARE = 0.02  # its zero
PRESLIDING_SHARE = 0.1  # friction below the lowest speed
# standard deviation of the share of dry friction that changes within one distance; convention
TURNOVER = 0.5
# standard deviation of the friction curve of a real joint from Coulomb and viscous friction,
# relative to its dry friction, by speed, direction, load and time
CURVE = 0.1
EVENT = 1e-6  # prior odds of an event in a recording
# range of the power of an event over the ordinary power of a residual: from noise to the whole load
# of an arm
LARGER = 1e8
CHANGED = 1e-2  # prior odds that a size differs between recordings of one arm
# prior odds that one of an arm's numbers steps in a history, shared by all numbers
STEP = 0.1
SCATTER = (
    0.01  # relative scatter of a size between recordings: friction changes by about 1 % per kelvin
)
# probability that a size is wrong if something is unknown: 21 of 23 causes at such joints were
UNSURE = 0.9
# Prior standard deviations within which a number is ordinary (contract).
ORDINARY = 3.0
MOTION = 8.0  # Hz; above, residuals are noise of the encoders
# power over the noise that a place may keep, in units of the noise: its uncertainty
NOISY = 2.0
LISTED = 0.01  # smallest probability of a listed alternative (contract)
SUMMED = 1e-3  # share of the most probable set's probability below which sets do not change sums
# Numbers of proposals that are evaluated in full.
TRIED = 5  # if one term is added or exchanged
TRIED_OF_TWO = 2  # if two terms change
SHORT = 0.3  # share of the needed gain that the first-order gain of a proposal must reach
WORTH = 1.0  # nats, least gain of a move; less is an alternative
# nats, range in which scores at different linearisations compare, by one set at several of them
COMPARED = 100.0
# share of its own gain that a move must keep beside another one
APART = 0.5
RELATED = 0.1  # correlation of two terms from which one may replace both
MOST = 48  # largest number of terms in a set; ordinary friction of seven joints takes 21
FIRST = 4  # largest number of effects in the first search with an exact description
# nats behind the best set up to which others are expanded: a frequent gain of one more term
OPEN = 10.0
RUNNERS_UP = 2  # sets after the best one that keep their linearisations; memory
ELSEWHERE = 2  # other sets that are linearised about themselves


REFERENCE = "docs/diagnosis.md lists the priors"
REMEDY = "Give a YAML file of standard deviations, such as stiffness: 0.3"
Deviation = Annotated[Number, Field(gt=0.0, allow_inf_nan=False, strict=False)]


class Priors(BaseModel):
    """Standard deviations of the numbers in a description, relative unless a unit is given.

    CAD masses omit cables, grease and covers; catalogues of harmonic drives state stiffness to
    about 30 % and no damping. The priors of sensors are in the files of their effects; `sensors`
    overrides them by the id of the effect.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    mass: Deviation = 0.06
    centre_of_mass: Deviation = 0.007  # m
    inertia: Deviation = 0.08  # of the mean moment of inertia about the centre of mass
    product_of_inertia: Deviation = 0.05  # of the same
    rotor: Deviation = 0.06
    stiffness: Deviation = 0.15
    damping: Deviation = 0.40
    # of a zero between recordings, over that of the zero itself: starts nearly repeat its error
    between_recordings: Deviation = 0.3
    # Nm; dry friction changes its sign gradually, below an unstated speed
    presliding: Deviation = 2.0
    sensors: Mapping[str, Deviation] = Field(default_factory=dict)
    # of a torque channel that is a current: magnets differ by motor and temperature
    torque_constant: Deviation = 0.15
    # of a controller from which torques are computed: of all its gains, because of the supply and
    # the magnets of a servo, and of kd relative to kp, because the resistance of the winding
    # changes the back-EMF in kd by some percent
    controller: Deviation = 0.20
    gain_ratio: Deviation = 0.03

    def of_currents(self, channels: Iterable[str]) -> Priors:
        """Return the priors of an arm with torque channels that are currents; stated priors stay.

        channels: "joint_torque" and "motor_torque", if they are currents.
        """
        gains = {f"{channel}_gain": self.torque_constant for channel in channels}
        return self.model_copy(update={"sensors": {**gains, **self.sensors}})


def read_priors(path: str | Path, sensors: Iterable[str]) -> Priors:
    """Read standard deviations from a YAML file; others keep their defaults.

    sensors: ids of the effects of sensors that have a prior.

    Raises a DiagnosisError if the file cannot be read, or contains an unknown key or an invalid
    standard deviation.
    """
    content = read_fields(path, DiagnosisError, REMEDY)
    known = sorted(sensors)
    try:
        priors = Priors.model_validate(content)
    except ValidationError as error:
        problem, remedy = explain(error, REFERENCE)
        raise DiagnosisError(f"{path}: {problem}", remedy) from None
    if unknown := [name for name in priors.sensors if name not in known]:
        raise DiagnosisError(
            f"{path}: sensors.{unknown[0]}: unknown key", f"Choose among {', '.join(known)}."
        )
    return priors
