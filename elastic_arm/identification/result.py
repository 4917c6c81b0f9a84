"""The result of an identification: parameters with standard deviations, as JSON, and as an arm file
to simulate."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import IdentificationError
from elastic_arm.formatting import JointUnits, rounded
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Fit
from elastic_arm.identification.verdict import (
    Excitation,
    checked,
    directions,
    relative_std,
    remarks,
    verdicts,
)
from elastic_arm.output_files import plain, write_result
from elastic_arm.results import Result, Row
from elastic_arm.robot import Inertia, Robot, save_robot

SCHEMA = "elastic_arm/identification/1"
ARMS = ("nominal", "identified", "consistent")
# What the equations compare, in words.
COMPARED = {
    "link": "link side",
    "motor": "motor side",
    "drive": "drive",
    "joint": "joint torque",
    "whole": "motor torque",
}


@dataclass(frozen=True)
class Estimate:
    """One base parameter, `name` a readable combination of parameters; values in `unit`.

    `std` is one standard deviation, `relative_std` that over the size that is natural for the
    parameter, and `verdict` whether the recording determines it "well", "poorly" or "not".
    """

    name: str
    unit: str
    value: float
    std: float
    nominal: float
    relative_std: float
    verdict: str

    @property
    def short(self) -> str:
        """Its name by the first term of the combination: `link_2.mx + 6 terms`."""
        first, *more = re.split(r" [+-] ", self.name)
        return f"{first} + {len(more)} term{'s' * (len(more) > 1)}" if more else first

    @property
    def is_friction(self) -> bool:
        """Whether it belongs to a law, as friction does, and not to the bodies."""
        return ":" in self.name


@dataclass(frozen=True)
class Carried:
    """A body on a link beyond its description."""

    link: str
    mass: float  # kg
    std: float
    centre: tuple[float, ...]  # m, in the link's frame
    probability: float  # that it is there, on this link
    last: bool  # whether that is the last link

    @property
    def body(self) -> Inertia:
        """The same as a point mass."""
        return Inertia(self.mass, np.array(self.centre))

    def words(self) -> str:
        """Return it as a sentence."""
        mass, std = rounded(self.mass, self.std)
        x, y, z = (round(1e3 * value) for value in self.centre)
        found = f"{self.link} carries {mass} ± {std} kg that the description lacks"
        guess = ": a tool?" if self.last else "."
        return f"{found}, centred at ({x}, {y}, {z}) mm in its frame{guess}"


@dataclass(frozen=True, repr=False)
class Identification(Result):
    """The result of identifying an arm.

    Parameters
    ----------
    robot, model, recordings, joints
        Names of the nominal arm, the model, the recordings and the joints.
    estimates, covariance
        Base parameters, and their covariance (B, B).
    noise
        Equation -> joint -> standard deviation of the residual, Nm, in the band of the derivative
        stage; for a rigid arm that of averages (:data:`.accumulator.AVERAGED`).
    condition, undetermined
        Condition number of the weighted, equilibrated regressor; descriptions of combinations
        that the data do not determine.
    samples, derivatives
        Number of samples used, and methods of the derivatives.
    excitation
        Judgement of the motion before the fit: condition, poor, reasons, weakest.
    parameter_names, T, Psi
        All parameters, the map to the base parameters (B, P), and physically consistent values of
        all parameters (P,), those of additional effects last; Psi is None if not requested.
    notes
        Further information for the user.
    consistency
        For Psi: `trust`, the relative error of the nominal arm with the highest likelihood;
        `misfit`, the additional misfit of the consistent arm relative to the noise;
        `correlation`, the factor by which errors that follow the motion exceed white ones.
    validation
        Recording -> "nominal", "identified" or "consistent" -> equation -> joint -> rms of the
        residual, Nm, on held-out data.
    identified
        The arm with the parameters of Psi; not part of the JSON file, see :meth:`save_robot`.
    prismatic
        The prismatic joints, which use N for Nm and m for rad.
    carried
        What a link carries beyond its description, such as a tool, where that is more probable.
    closed_loop
        For an arm with commands: joint -> error under the recorded commands, for the description
        and for the written correction.
    """

    _report = "elastic_arm.report.identification"

    robot: str
    model: str
    recordings: tuple[str, ...]
    joints: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    noise: dict[str, dict[str, float]]
    condition: float
    undetermined: tuple[str, ...]
    samples: int
    derivatives: tuple[str, ...]
    excitation: dict[str, Any]
    parameter_names: tuple[str, ...]
    T: Array
    covariance: Array
    Psi: Array | None = None
    notes: tuple[str, ...] = ()
    consistency: dict[str, float] | None = None
    validation: dict[str, dict[str, dict[str, dict[str, float]]]] | None = None
    identified: Robot | None = None
    prismatic: tuple[str, ...] = ()
    closed_loop: dict[str, dict[str, Any]] | None = None
    carried: Carried | None = None

    @property
    def units(self) -> JointUnits:
        """Units of quantities at the joints."""
        return JointUnits(self.joints, self.prismatic)

    @property
    def Psi_base(self) -> Array:
        """Values of the base parameters (B,)."""
        return np.array([e.value for e in self.estimates])

    @property
    def std(self) -> Array:
        """Standard deviations of the base parameters (B,)."""
        return np.array([e.std for e in self.estimates])

    def with_(self, **changes: Any) -> Identification:
        """Return the result with some fields changed."""
        return replace(self, **changes)

    def tables(self) -> dict[str, Sequence[Row]]:
        """Return the tables "parameters" and "residuals": root mean squares of the fit and on
        held-out data."""
        parameters = [{"short": e.short, **asdict(e)} for e in self.estimates]
        sizes = {"fit": {"identified": self.noise}, **(self.validation or {})}
        residuals = [
            {"recording": recording, "arm": arm, "equation": equation, "joint": joint, "rms": rms}
            for recording, arms in sizes.items()
            for arm, by_equation in arms.items()
            for equation, by_joint in by_equation.items()
            for joint, rms in by_joint.items()
        ]
        return {"parameters": parameters, "residuals": residuals}

    def table(self) -> list[tuple[str, str, float, float, float, str]]:
        """Return rows (name, unit, value, std, nominal, verdict)."""
        return [(e.name, e.unit, e.value, e.std, e.nominal, e.verdict) for e in self.estimates]

    def summary(self) -> list[str]:
        """Return the result as sentences: determined parameters, and errors of the arm on held-out
        motions."""
        words = [e.verdict for e in self.estimates]
        counts = f"{words.count('poorly')} poorly, {words.count('not')} not determined"
        found = [f"{words.count('well')} of {len(words)} parameters are well determined, {counts}."]
        if self.carried is not None:
            found.append(self.carried.words())
        for recording, arms in (self.validation or {}).items():
            nominal, identified = (self._largest_error(arms[arm]) for arm in ARMS[:2])
            errors = f"the error of the nominal arm is up to {nominal}, that of the identified arm"
            found.append(f"On {recording}, which was held out, {errors} up to {identified}.")
        return found

    def _largest_error(self, errors: Mapping[str, Mapping[str, float]]) -> str:
        """Return the largest error, by equation and joint, with its place as text."""
        error, joint, side = max(
            (error, joint, side) for side, at in errors.items() for joint, error in at.items()
        )
        return f"{error:.3g} {self.units.at(joint, 'Nm')} ({joint}, {COMPARED[side]})"

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data; numbers that are not finite become null."""
        return {
            "schema": SCHEMA,
            **plain({f: getattr(self, f) for f in self.__dataclass_fields__ if f != "identified"}),
        }

    def to_json(self, path: str | Path | None = None) -> str:
        """Return the result as JSON text, and write it to `path` if given.

        Raises an IdentificationError if the file cannot be written.
        """
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False)
        if path is not None:
            write_result(path, text + "\n", IdentificationError, "Choose another folder.")
        return text

    @staticmethod
    def load(path: str | Path) -> Identification:
        """Read a result that :meth:`to_json` wrote.

        Raises an IdentificationError if the file is not such a result.
        """
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise IdentificationError(
                f"{path} cannot be read: {error}", "Give an identification.json."
            ) from None
        if not isinstance(data, dict) or data.pop("schema", None) != SCHEMA:
            raise IdentificationError(
                f"{path} is not an identification", f"Its schema must be {SCHEMA}."
            )
        try:
            return _from_dict(data)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            what = f"{path} is not a complete identification ({type(error).__name__}: {error})"
            raise IdentificationError(what, "Identify again, or give another file.") from None

    def save_robot(self, path: str | Path) -> None:
        """Write the identified arm as an arm file for `load_robot` and the simulator.

        Raises an IdentificationError if no physically consistent parameters were identified.
        """
        if self.identified is None:
            problem = "no complete set of parameters was identified"
            raise IdentificationError(problem, "Identify with physical consistency (--consistent).")
        save_robot(self.identified, path)


def result_of(
    fit: Fit,
    equations: BaseRegression,
    judged: Excitation,
    samples: int,
    recordings: tuple[str, ...],
    methods: tuple[str, ...],
) -> Identification:
    """Return the result of a fit."""
    base = equations.base
    robot = equations.model.robot
    relative = relative_std(equations, fit.Psi, fit.std)
    words = checked(verdicts(relative), fit, equations, judged.one_way)
    motion: dict[str, Any] = {"condition": judged.condition, "poor": judged.poor}
    motion |= {"reasons": list(judged.reasons), "weakest": list(judged.weakest)}
    numbers = (values.tolist() for values in (fit.Psi, fit.std, equations.described, relative))
    return Identification(
        robot=robot.name,
        model=equations.model.name,
        recordings=recordings,
        joints=equations.joints,
        prismatic=tuple(robot.units.prismatic),
        estimates=tuple(
            Estimate(*row) for row in zip(base.names, base.units, *numbers, words, strict=True)
        ),
        noise=equations.by_joint(fit.noise),
        condition=fit.condition,
        undetermined=directions(fit.undetermined, base.names),
        samples=samples,
        derivatives=methods,
        excitation=motion,
        parameter_names=equations.names,
        T=base.T,
        covariance=fit.covariance,
        notes=remarks(fit, equations, judged.one_way),
    )


def _from_dict(data: dict[str, Any]) -> Identification:
    for e in data["estimates"]:
        e |= {name: np.inf for name, value in e.items() if value is None}
    data["estimates"] = tuple(Estimate(**e) for e in data["estimates"])
    for name in (
        "recordings",
        "joints",
        "undetermined",
        "derivatives",
        "parameter_names",
        "notes",
        "prismatic",
    ):
        data[name] = tuple(data.get(name, ()))
    for name in ("T", "covariance", "Psi"):
        data[name] = None if data[name] is None else np.array(data[name], dtype=float)
    if data.get("carried") is not None:
        data["carried"]["centre"] = tuple(data["carried"]["centre"])
        data["carried"] = Carried(**data["carried"])
    data["condition"] = np.inf if data["condition"] is None else data["condition"]
    return Identification(**data)
