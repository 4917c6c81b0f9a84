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
    """What kind of description and sensors an arm may have."""

    factor: float  # on the standard deviations of the numbers
    prior: float  # probability of the kind
    coloured: float  # prior odds that the noise of a place has a spectrum of its own


# A simulation is as measured, an identified arm as calibrated, drawings and catalogues are as
# built; convention.
TRUST = {
    "as measured": Trust(1e-5, 0.3, 1e-3),
    "as calibrated": Trust(0.2, 0.3, 0.1),
    "as built": Trust(1.0, 0.3, 0.1),
    "rough": Trust(4.0, 0.1, 0.1),
}
# Common scale of the zeros and drifts of one arm's torque channels, with its probability: sensors
# of one make, warmed up alike. Twice as large is half as likely.
ZEROS = {1.0: 8 / 15, 2.0: 4 / 15, 4.0: 2 / 15, 8.0: 1 / 15}


# the kinds of trust from which a search starts
MEASURED = "as measured"
BUILT = "as built"


class Assumed(NamedTuple):
    """What all priors of an arm share."""

    trust: str  # in the description, of :data:`TRUST`
    zeros: float = 1.0  # scale of the torque channels' zeros, of :data:`ZEROS`


AS_MEASURED = Assumed(MEASURED)
AS_BUILT = Assumed(BUILT)
# Prior odds that a drive has friction that its description does not state; not under `as measured`,
# which is a simulation.
USUAL = 9.0
# that an effect is there or a number is far off: of a hundred sound arms, one has a false cause
ODDS = 1e-2
# odds of a nonparametric law over those of an effect: the catalogue has what arms mostly have
FORMLESS = 1e-3
SCALES = np.array([1.0, 0.1, 0.01, 1e-3, 1e-4])  # of a size's range: effects are of all sizes
# standard deviation of a number that is far off, in ordinary ones: hardly any prior; convention
WIDE = 30.0
# relative standard deviation of a stated effect: friction changes so with temperature and wear
STATED = 0.3
# Nm; of nonparametric laws, joints of every kind
SIZES = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
LEFT = 0.1  # share of a place's own gap that may be left (contract)
ZERO_AS_MOUNTED = (
    1e-3  # rad; of a link encoder never compared with the motor's under a known torque
)
# Of a joint's largest torque.
OFFSET_SHARE = 0.02  # its zero
PRESLIDING_SHARE = 0.1  # its friction below the least speed
# of the share of dry friction that turns over within one distance, standard deviation; convention
TURNOVER = 0.5
# of the friction curve of a real joint about Coulomb and viscous friction, relative to its dry
# friction, standard deviation: by speed, direction, load and time
CURVE = 0.1
EVENT = 1e-6  # prior odds of an event in a recording: as of an effect
# range of the power of an event over the ordinary one of a residual: from noise to all that an arm
# carries
LARGER = 1e8
CHANGED = 1e-2  # prior odds that a size is not the same in all recordings of one arm
# prior odds that one of an arm's numbers steps in a history, shared by them; asked where it may
# have
STEP = 0.1
SCATTER = (
    0.01  # relative, of a size from recording to recording: friction changes by about 1 % a kelvin
)
# probability that a size is wrong where something is unknown: of 23 causes at such joints 21 were
UNSURE = 0.9
# Deviations of its prior within which a number is ordinary, as more likely than not (contract).
ORDINARY = 3.0
MOTION = 8.0  # Hz; above, what is left is the encoders'
# power that a place may keep over its sensors' noise, in that noise: how badly a noise is known
NOISY = 2.0
LISTED = 0.01  # probability of an alternative that is listed (contract)
SUMMED = 1e-3  # of the most probable set's probability: what is less likely changes no sum
# Proposals that are evaluated in full.
TRIED = 5  # of a term that is added or exchanged
TRIED_OF_TWO = 2  # where two of them change
SHORT = (
    0.3  # share of what a move needs that its first-order gain must reach to be evaluated in full
)
WORTH = 1.0  # nats of a move that is taken: less is an alternative
# nats up to which scores at different linearisations compare, as those of one set at several show
COMPARED = 100.0
# share of its own gain that a move keeps beside another one that is taken with it
APART = 0.5
RELATED = 0.1  # correlation of two terms from which one may stand for both
MOST = 48  # terms of a set; ordinary friction of seven joints takes 21
FIRST = 4  # effects of an arm that is exactly as described, at the first look
# nats behind the best up to which a set is expanded as well: what one more term is often worth
OPEN = 10.0
RUNNERS_UP = 2  # sets behind the best whose linearisations are kept; memory
ELSEWHERE = 2  # other sets that are linearised for themselves


REFERENCE = "docs/diagnosis.md lists the priors"
REMEDY = "Give a YAML file of standard deviations, such as stiffness: 0.3"
Deviation = Annotated[Number, Field(gt=0.0, allow_inf_nan=False, strict=False)]


class Priors(BaseModel):
    """Standard deviations of what a description states of an arm, relative where no unit is given.

    CAD masses leave out cables, grease and covers; catalogues of harmonic drives state stiffness to
    about 30 % and give no damping. What sensors do is stated in the files of their effects;
    `sensors` overrules it, by the effect's id.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    mass: Deviation = 0.06
    centre_of_mass: Deviation = 0.007  # m
    inertia: Deviation = 0.08  # of the mean moment of inertia about the centre of mass
    product_of_inertia: Deviation = 0.05  # of the same
    rotor: Deviation = 0.06
    stiffness: Deviation = 0.15
    damping: Deviation = 0.40
    # Of a zero between recordings, over that of the zero itself: what it was set wrong by, each
    # start repeats nearly.
    between_recordings: Deviation = 0.3
    presliding: Deviation = (
        2.0  # Nm; dry friction turns over gradually, below a speed that nobody states
    )
    sensors: Mapping[str, Deviation] = Field(default_factory=dict)
    torque_constant: Deviation = (
        0.15  # of a torque channel that is a current; of magnets, by motor and temperature
    )

    # Of a controller that torques are made by: of all its gains, by a servo's supply and magnets;
    # and of kd beside kp: firmware holds both as numbers, the winding's resistance changes the
    # back-EMF that counts as kd by some percent.
    controller: Deviation = 0.20
    gain_ratio: Deviation = 0.03

    def of_currents(self, channels: Iterable[str]) -> Priors:
        """Return those of an arm of which torque channels are currents; what was stated stays.

        channels: that are currents, of "joint_torque" and "motor_torque".
        """
        gains = {f"{channel}_gain": self.torque_constant for channel in channels}
        return self.model_copy(update={"sensors": {**gains, **self.sensors}})


def read_priors(path: str | Path, sensors: Iterable[str]) -> Priors:
    """Read standard deviations from a YAML file; those that it leaves out keep their defaults.

    sensors: ids of the effects of sensors that have a prior.

    Raises a DiagnosisError if the file cannot be read, or holds an unknown key or what is no
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
