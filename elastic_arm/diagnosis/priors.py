"""How far the numbers of a description and of its sensors are ordinarily off, and a file that states it otherwise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from elastic_arm.errors import DiagnosisError
from elastic_arm.input_files import Number, explain, read_fields

COMMISSIONED = 0.2  # of what a description of parts is off by: masses to 1.2 %, centres of mass to 1.4 mm; convention
OF_THE_ARM = ("mass", "centre_of_mass", "inertia", "product_of_inertia", "rotor", "stiffness", "damping")
REFERENCE = "docs/diagnosis.md lists the priors"
REMEDY = "Give a YAML file of standard deviations, such as stiffness: 0.3"
Deviation = Annotated[Number, Field(gt=0.0, allow_inf_nan=False, strict=False)]


class Priors(BaseModel):
    """Standard deviations of what a description states of an arm, relative where no unit is given.

    CAD masses leave out cables, grease and covers; catalogues of harmonic drives state stiffness to about 30 % and give
    no damping. What sensors do is stated in the files of their effects; `sensors` overrules it, by the effect's id.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    mass: Deviation = 0.06
    centre_of_mass: Deviation = 0.007  # m
    inertia: Deviation = 0.08  # of the mean moment of inertia about the centre of mass
    product_of_inertia: Deviation = 0.05  # of the same
    rotor: Deviation = 0.06
    stiffness: Deviation = 0.15
    damping: Deviation = 0.40
    # Of a zero between recordings, over that of the zero itself: what it was set wrong by, each start repeats nearly.
    between_recordings: Deviation = 0.3
    presliding: Deviation = 2.0  # Nm; dry friction turns over gradually, below a speed that nobody states
    sensors: Mapping[str, Deviation] = Field(default_factory=dict)
    torque_constant: Deviation = 0.15  # of a torque channel that is a current; of magnets, by motor and temperature

    def of_currents(self, channels: Iterable[str]) -> Priors:
        """Return those of an arm of which some torque channels are currents; what was stated of their gains stays.

        Parameters
        ----------
        channels
            Of "joint_torque" and "motor_torque".
        """
        gains = {f"{channel}_gain": self.torque_constant for channel in channels}
        return self.model_copy(update={"sensors": {**gains, **self.sensors}})

    def commissioned(self) -> Priors:
        """Return those of an arm that was calibrated before: a fifth, but for sensors and what was stated."""
        known = {name: COMMISSIONED * getattr(self, name) for name in OF_THE_ARM if name not in self.model_fields_set}
        return self.model_copy(update=known)


def read_priors(path: str | Path, sensors: Iterable[str]) -> Priors:
    """Read standard deviations from a YAML file; those that it leaves out keep their defaults.

    Parameters
    ----------
    path
        The file.
    sensors
        Ids of the effects of sensors that have a prior.

    Raises
    ------
    DiagnosisError
        If the file cannot be read, or holds an unknown key or what is no standard deviation.
    """
    content, known = read_fields(path, DiagnosisError, REMEDY), sorted(sensors)
    try:
        priors = Priors.model_validate(content)
    except ValidationError as error:
        problem, remedy = explain(error, REFERENCE)
        raise DiagnosisError(f"{path}: {problem}", remedy) from None
    if unknown := [name for name in priors.sensors if name not in known]:
        raise DiagnosisError(f"{path}: sensors.{unknown[0]}: unknown key", f"Choose of {', '.join(known)}.")
    return priors
