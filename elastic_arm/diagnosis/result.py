"""The result of a diagnosis: the content of `diagnosis.json`."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.effects.model import MODELS
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.equations import SIDES
from elastic_arm.formatting import JointUnits
from elastic_arm.output_files import write_result

if TYPE_CHECKING:
    from elastic_arm.diagnosis.context import DiagnosisContext
    from elastic_arm.diagnosis.design.proposal import Proposal
    from elastic_arm.diagnosis.inference.estimates import Agreement
    from elastic_arm.diagnosis.inference.prediction import Prediction
    from elastic_arm.effects.model import EffectInstance

Key = tuple[str, str | None]  # effect and joint

SCHEMA = "elastic_arm/diagnosis/1"
SEPARATING = "separating_trajectory.yaml"  # the proposed motion, beside diagnosis.json


@dataclass(frozen=True)
class Alternative:
    """Another effect that could stand in a cause's place.

    Parameters
    ----------
    effect, joint, confidence
        What it is, and the probability that it is right.
    separated_by
        The motion that would discriminate between the two, in a sentence.
    file
        The same as a trajectory file, where one was proposed that is expected to decide.
    """

    effect: str
    joint: str | None
    confidence: float
    separated_by: str
    file: str | None = None


@dataclass(frozen=True)
class Cause:
    """An effect that the model lacks.

    Parameters
    ----------
    effect, joint, sides, regime
        What, where, and when it shows.
    parameters
        Values with standard deviations and units.
    shrink
        Share of the whole gap that goes when this cause alone is added.
    confidence
        Probability that it is right, among the candidates that compete.
    alternatives
        The others.
    instance
        As the simulator takes it.
    minor
        Whether it is a term of friction that takes less off the gap than a cause by itself must. It is there beyond
        doubt, and never stands in for something else.
    refitted
        Whether it is a number of the arm beyond ordinary: the refitted numbers hold it.
    stands_in
        Whether something else is likelier than not in its place: a law that no catalogue states, or one that has
        another size in every recording.
    """

    effect: str
    joint: str | None
    sides: tuple[str, ...]
    regime: str
    parameters: Mapping[str, ParameterEstimate]
    shrink: float
    confidence: float
    alternatives: tuple[Alternative, ...]
    instance: EffectInstance
    minor: bool = False
    refitted: bool = False
    stands_in: bool = False

    @property
    def held_as(self) -> str | None:
        """What it is of the corrected arm.

        An "effect", a "number", or part of a richer "variant" of the model, which no arm file holds; None where it is
        left out, as it only stands in for something else.
        """
        if self.refitted:
            return "number"
        if self.stands_in:
            return None
        return "effect" if self.instance.effect.lacked_by == MODELS else "variant"

    @property
    def acts(self) -> bool:
        """Whether the prediction with the causes has it, and that without them has not."""
        return self.held_as in ("effect", "variant")

    def against(self, odds: float) -> Cause:
        """Return it where something else has these odds to be there in its place."""
        stands_in = self.stands_in or (odds > 1.0 and not self.minor)
        return replace(self.less_sure(1.0 / (1.0 + odds)), stands_in=stands_in)

    def less_sure(self, share: float) -> Cause:
        """Return it with its own and its alternatives' confidence reduced to a share.

        An incomplete hypothesis may owe its causes to what it lacks: it is worth the share of the gap it explains.
        """
        alternatives = tuple(replace(a, confidence=share * a.confidence) for a in self.alternatives)
        return replace(self, confidence=share * self.confidence, alternatives=alternatives)

    def with_separating_file(self, decided: Collection[tuple[Key, Key]]) -> Cause:
        """Return it with the proposed file at the alternatives that it is expected to decide on.

        Parameters
        ----------
        decided
            Pairs of cause and alternative, each by effect and joint, on which the motion is expected to decide.
        """

        def with_file(other: Alternative) -> Alternative:
            pair = (self.effect, self.joint), (other.effect, other.joint)
            return replace(other, file=SEPARATING) if pair in decided else other

        return replace(self, alternatives=tuple(with_file(other) for other in self.alternatives))

    def to_dict(self) -> dict[str, Any]:
        """Return it as in `diagnosis.json`."""
        parameters = plain_parameters(self.parameters)
        for choice in self.instance.effect.choices:
            if choice.name != "side":
                chosen = self.instance.parameters[choice.name]
                value = list(chosen) if isinstance(chosen, tuple) else chosen
                parameters[choice.name] = {"value": value, "std": None, "unit": ""}
        return {
            "effect": self.effect,
            "joint": self.joint,
            "sides": list(self.sides),
            "regime": self.regime,
            "parameters": parameters,
            "shrink": _plain(self.shrink),
            "minor": self.minor,
            "stands_in": self.stands_in,
            "held_as": self.held_as,
            "confidence": _plain(self.confidence),
            "alternatives": [
                {
                    "effect": a.effect,
                    "joint": a.joint,
                    "confidence": _plain(a.confidence),
                    "separated_by": a.file or a.separated_by,
                }
                for a in self.alternatives
            ],
        }


@dataclass(frozen=True)
class Imperfection:
    """What a recording determines of one number of the description or of a sensor.

    Parameters
    ----------
    what, joint, unit
        Which number.
    value, std
        With its standard deviation: a ratio for unit "1", else a deviation.
    prior_std
        Over ordinary arms.
    ordinary
        Whether it is within what is ordinary.
    recording
        Of a zero that is another one in this recording than in the first, by how much; None of any other number.
    neutral
        Its value on an arm that is as described.
    """

    what: str
    joint: str
    unit: str
    value: float
    std: float
    prior_std: float
    ordinary: bool
    recording: str | None = None
    neutral: float = 0.0

    def differs(self, quantile: float) -> bool:
        """Whether it is not as described, by so many standard deviations."""
        return abs(self.value - self.neutral) > quantile * self.std

    def to_dict(self) -> dict[str, Any]:
        """Return it as in `diagnosis.json`."""
        of_one = {} if self.recording is None else {"recording": self.recording}
        return {
            "what": self.what,
            "joint": self.joint,
            "value": _plain(self.value),
            "std": _plain(self.std),
            "unit": self.unit,
            "prior_std": _plain(self.prior_std),
            "ordinary": self.ordinary,
            **of_one,
        }


@dataclass(frozen=True)
class UnexplainedResidual:
    """Where something is left that no cause explains."""

    joint: str
    side: str
    regime: str
    rmse: float


@dataclass(frozen=True)
class ResidualSizes:
    """A residual's sizes over joints and sides, by name; a missing equation is missing here."""

    rmse: Mapping[tuple[str, str], float]
    peak: Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class Diagnosis:
    """The gap between a recording and a model, explained as far as it can be.

    Parameters
    ----------
    model, robot, joints
        What was compared with.
    prismatic
        The joints that slide: N at these for Nm, m for rad.
    identify, validate
        Sources of the recordings.
    independent_motion
        Whether the validation motion is another one.
    band
        Hz.
    verdict
        "none", "explained" or "unknown".
    noise
        (joint, side) -> Nm.
    before, after
        Sizes on the validation data.
    shrink, shrink_interval
        None where there is no gap.
    shrink_by_place
        (joint, side) -> share of its own excess that is gone, None where it had none; empty where no residual shows
        the gap.
    measured_by
        "excess" of residuals over their noise, as the contract has it, or "likelihood" where no residual stands out of
        its noise by itself.
    log_likelihood
        What the causes gain, nats: on each data set with coefficients of the other.
    causes, unexplained
        What was found, most important first, and where something is left. The figures of the gap after, and of its
        shrink, are with all causes added, also those that only stand in for something else.
    imperfections
        Numbers of the description and of the sensors that the recording determines, where the model was refitted.
    known
        Effects that count as part of the model, with the sizes that were fitted, as in `diagnosis.json`.
    notes
        What the reader should know besides.
    cumulative_shrink
        Share of the gap that is gone with the first cause, the first two, and so on.
    prediction
        How far ahead the model sees, without and with the causes that act.
    agreements
        The causes recording by recording, where there are several.
    proposal
        The motion that discriminates between causes and their alternatives.
    context
        What figures are drawn from; not written.
    """

    model: str
    robot: str
    joints: tuple[str, ...]
    identify: tuple[str, ...]
    validate: tuple[str, ...]
    independent_motion: bool
    band: float
    verdict: str
    noise: Mapping[tuple[str, str], float]
    before: ResidualSizes
    after: ResidualSizes
    shrink: float | None
    shrink_interval: tuple[float, float] | None
    measured_by: str
    log_likelihood: float
    causes: tuple[Cause, ...]
    unexplained: tuple[UnexplainedResidual, ...]
    prismatic: tuple[str, ...] = ()
    shrink_by_place: Mapping[tuple[str, str], float | None] = field(default_factory=dict)
    imperfections: tuple[Imperfection, ...] = ()
    known: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    cumulative_shrink: tuple[float, ...] = ()
    prediction: Prediction | None = None
    agreements: tuple[Agreement, ...] = ()
    proposal: Proposal | None = None
    context: DiagnosisContext | None = field(default=None, repr=False, compare=False)

    @property
    def units(self) -> JointUnits:
        """Units of quantities at the joints."""
        return JointUnits(self.joints, self.prismatic)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `diagnosis.json`."""
        return {
            "schema": SCHEMA,
            "model": self.model,
            "robot": self.robot,
            **({"prismatic": list(self.prismatic)} if self.prismatic else {}),
            "recordings": {
                "identify": list(self.identify),
                "validate": list(self.validate),
                "independent_motion": self.independent_motion,
            },
            "band_hz": [0.0, _plain(self.band)],
            "verdict": self.verdict,
            "noise": self._table(self.noise),
            "gap": {"before": self._sizes(self.before), "after": self._sizes(self.after)},
            "shrink": _plain(self.shrink),
            "shrink_interval": None if self.shrink_interval is None else [_plain(v) for v in self.shrink_interval],
            "shrink_by_place": self._table(self.shrink_by_place),
            "measured_by": self.measured_by,
            "log_likelihood": _plain(self.log_likelihood),
            "causes": [cause.to_dict() for cause in self.causes],
            "unexplained": [
                {"joint": p.joint, "side": p.side, "regime": p.regime, "rmse": _plain(p.rmse)} for p in self.unexplained
            ],
            "imperfections": [one.to_dict() for one in self.imperfections],
            "known": [dict(one) for one in self.known],
            "notes": list(self.notes),
            "ladder": [_plain(share) for share in self.cumulative_shrink],
            "prediction": None if self.prediction is None else self.prediction.to_dict(self.units.over("rad")),
            "agreement": [agreement.to_dict() for agreement in self.agreements],
            "next_motion": None if self.proposal is None else self.proposal.to_dict(SEPARATING),
        }

    def save(self, path: str | Path) -> Path:
        """Write `diagnosis.json`.

        Raises
        ------
        DiagnosisError
            If the file cannot be written.
        """
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False)
        return write_result(path, f"{text}\n", DiagnosisError, "Choose another --out")

    def _table(self, values: Mapping[tuple[str, str], float | None]) -> dict[str, Any]:
        return {joint: {side: _plain(values.get((joint, side))) for side in SIDES} for joint in self.joints}

    def _sizes(self, size: ResidualSizes) -> dict[str, Any]:
        def cell(joint: str, side: str) -> dict[str, Any] | None:
            place = (joint, side)
            return {"rmse": _plain(size.rmse[place]), "max": _plain(size.peak[place])} if place in size.rmse else None

        return {joint: {side: cell(joint, side) for side in SIDES} for joint in self.joints}


def plain_parameters(parameters: Mapping[str, ParameterEstimate]) -> dict[str, Any]:
    """Return parameters as in `diagnosis.json`."""
    return {name: {"value": _plain(e.value), "std": _plain(e.std), "unit": e.unit} for name, e in parameters.items()}


def _plain(value: Any) -> Any:
    """Return numbers as JSON takes them, with seven significant digits."""
    if value is None:
        return None
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str):
        return [_plain(v) for v in value]
    number = float(value)
    return float(f"{number:.7g}") if np.isfinite(number) else None
