"""The result of a diagnosis: the content of `diagnosis.json`."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from elastic_arm import output_files
from elastic_arm.diagnosis.estimates import ParameterEstimate
from elastic_arm.diagnosis.events import Event
from elastic_arm.effects import Catalogue
from elastic_arm.effects.effect import MODELS, ControllerEffect, EffectInstance
from elastic_arm.equations.numbers import SCALE
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.equation_sets import SIDES, Place
from elastic_arm.formatting import JointUnits
from elastic_arm.recording import Side
from elastic_arm.recording.sides import joined_sides
from elastic_arm.results import ClosedLoopError, Result, Row

if TYPE_CHECKING:
    from elastic_arm.diagnosis.context import DiagnosisContext
    from elastic_arm.diagnosis.prediction import Prediction
    from elastic_arm.excitation import FourierTrajectory

SCHEMA = "elastic_arm/diagnosis/2"
plain = partial(output_files.plain, digits=7)  # as in `diagnosis.json`
SEPARATING = "separating_trajectory.yaml"  # the proposed motion, beside diagnosis.json


@dataclass(frozen=True)
class Alternative:
    """Another effect that may act instead of a cause, and the motion that would separate both."""

    effect: str
    joint: str | None
    confidence: float
    separated_by: str
    file: str | None = None


@dataclass(frozen=True)
class Cause:
    """An effect that the model lacks, or a number that is far from its described value."""

    # effect, joint, sides, regime: what, where, and when it appears
    effect: str
    joint: str | None
    sides: tuple[str, ...]
    regime: str
    parameters: Mapping[str, ParameterEstimate]  # values with standard deviations and units
    shrink: float  # share of the whole gap that this cause alone removes
    confidence: float  # its posterior probability
    alternatives: tuple[Alternative, ...]  # effects that may act instead
    instance: EffectInstance  # for the simulator
    stated: Mapping[str, Any] | None = None
    is_number: bool = False  # whether the corrected arm contains it as a number of the arm
    # share of the gap at its places that returns on the validation recordings if it is removed and
    # the other terms are refitted; None without a gap
    shrink_without: float | None = None
    # whether a commanded arm moves worse with its correction, which is then not written
    rejected: bool = False

    @property
    def held_as(self) -> str:
        """Its form in the corrected arm: "effect", "number", "controller", or a richer model
        "variant"."""
        if isinstance(self.instance.effect, ControllerEffect):
            return "controller"
        if self.is_number:
            return "number"
        return "effect" if self.instance.effect.lacked_by == MODELS else "variant"

    @property
    def acts(self) -> bool:
        """Whether a prediction with the causes adds its law."""
        return not self.is_number

    def with_separating_file(self, decided: Collection[tuple[Any, Any]]) -> Cause:
        """Return the cause with the proposed file at the alternatives that the motion should
        decide."""
        own = self.effect, self.joint
        which = [(own, (a.effect, a.joint)) in decided for a in self.alternatives]
        pairs = zip(self.alternatives, which, strict=True)
        return replace(
            self, alternatives=tuple(replace(a, file=SEPARATING) if yes else a for a, yes in pairs)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as in `diagnosis.json`."""
        parameters = plain(self.parameters)
        for parameter in self.instance.effect.parameters:
            if parameter.integer and parameter.name in parameters:
                parameters[parameter.name]["std"] = None
        for choice in self.instance.effect.choices:
            if choice.name != "side":
                chosen = self.instance.parameters[choice.name]
                value = list(chosen) if isinstance(chosen, tuple) else chosen
                parameters[choice.name] = {"value": value, "std": None, "unit": ""}
        found = {name: plain(one.value) for name, one in self.parameters.items()}
        return {
            "effect": self.effect,
            "joint": self.joint,
            "sides": list(self.sides),
            "regime": self.regime,
            "parameters": parameters,
            "shrink": plain(self.shrink),
            "confidence": plain(self.confidence),
            "shrink_without": plain(self.shrink_without),
            "from": plain(self.stated),
            "to": None if self.stated is None else found,
            "held_as": self.held_as,
            "rejected": self.rejected,
            "alternatives": [
                {
                    "effect": a.effect,
                    "joint": a.joint,
                    "confidence": plain(a.confidence),
                    "separated_by": a.file or a.separated_by,
                }
                for a in self.alternatives
            ],
        }


@dataclass(frozen=True)
class UnconfirmedCause:
    """A probable effect that is not a cause.

    It gains nothing on the validation recordings, its size is zero within two standard deviations,
    it could be ordinary, or it may be part of an unknown effect at its joint.
    """

    effect: str
    joint: str | None
    confidence: (
        float  # its posterior probability, times that of not being part of an unknown effect
    )
    shrink_without: float | None  # as for a cause; None if it was not measured


@dataclass(frozen=True)
class Imperfection:
    """The estimate of one number of the description or of a sensor."""

    # what, joint, unit: which number
    what: str
    joint: str
    unit: str
    # value, std: a ratio for unit "1", otherwise a deviation, with its standard deviation
    value: float
    std: float
    prior_std: float  # standard deviation over ordinary arms
    ordinary: bool  # whether it is probably within its ordinary deviations
    # recording of a zero that differs from that in the first recording; None for any other number
    recording: str | None = None
    neutral: float = 0.0  # its value on an arm as described

    def to_dict(self) -> dict[str, Any]:
        """Return it as in `diagnosis.json`."""
        of_one = {} if self.recording is None else {"recording": self.recording}
        numbers = {name: plain(getattr(self, name)) for name in ("value", "std", "prior_std")}
        named = {"what": self.what, "joint": self.joint}
        return {**named, **numbers, "unit": self.unit, "ordinary": self.ordinary, **of_one}


@dataclass(frozen=True)
class ComparedScale:
    """The scale of a joint's torques, true / described, from two measures of the same motion."""

    of_torques: ParameterEstimate  # by the residuals of the torques
    in_closed_loop: ParameterEstimate  # by the simulated angles; the written arm contains it

    def to_dict(self) -> dict[str, Any]:
        """Return it as in `diagnosis.json`."""
        measures = ("of_torques", self.of_torques), ("in_closed_loop", self.in_closed_loop)
        return {name: {"value": plain(one.value), "std": plain(one.std)} for name, one in measures}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> ComparedScale | None:
        """Return what :meth:`to_dict` gave; None where a scale was not compared."""
        if "in_closed_loop" not in data:
            return None
        return ComparedScale(
            ParameterEstimate(**data["of_torques"], unit="1"),
            ParameterEstimate(**data["in_closed_loop"], unit="1"),
        )


@dataclass(frozen=True)
class Change:
    """A cause whose size differs between recordings."""

    # effect, joint: what and where
    effect: str
    joint: str | None
    # parameter, unit: its size
    parameter: str
    unit: str
    values: tuple[tuple[str, float, float], ...]  # (recording, value, standard deviation) each
    confidence: float  # probability that the sizes differ

    def to_dict(self) -> dict[str, Any]:
        """Return it as in `diagnosis.json`."""
        return {
            "effect": self.effect,
            "joint": self.joint,
            "parameter": self.parameter,
            "unit": self.unit,
            "values": [
                {"recording": r, "value": plain(v), "std": plain(s)} for r, v, s in self.values
            ],
            "confidence": plain(self.confidence),
        }


@dataclass(frozen=True)
class UnexplainedResidual:
    """A residual that no cause explains."""

    joint: str
    side: str
    regime: str
    rmse: float


@dataclass(frozen=True)
class ResidualSizes:
    """The sizes of residuals by joint and side; missing equations are absent."""

    rmse: Mapping[Place, float]
    peak: Mapping[Place, float]


@dataclass(frozen=True)
class PairSeparation:
    """Two competing effects, and the discrimination of recordings between them."""

    # cause, alternative: effect and joint of the two
    cause: tuple[str, str | None]
    alternative: tuple[str, str | None]
    # here, expected: log-likelihood ratio in this recording, and the expected one of the proposed
    # motion, nats
    here: float
    expected: float = 0.0
    decides: bool = False  # whether the proposed motion is expected to decide

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        effect, joint = self.cause
        other, other_joint = self.alternative
        return {
            "cause": {"effect": effect, "joint": joint},
            "alternative": {"effect": other, "joint": other_joint},
            "log_likelihood": {
                "this_recording": float(f"{self.here:.4g}"),
                "proposed": float(f"{self.expected:.4g}"),
            },
            "decides": self.decides,
        }


@dataclass(frozen=True)
class Proposal:
    """A motion that is expected to discriminate between effects."""

    trajectory: FourierTrajectory | None  # None if no motion within the limits was found
    pairs: tuple[PairSeparation, ...]  # pairs of effects and their separation
    candidates: int  # number of motions tried
    notes: tuple[str, ...] = ()  # assumptions, or why there is no motion

    @property
    def seconds(self) -> float:
        """Duration of the motion, s."""
        return 0.0 if self.trajectory is None else self.trajectory.duration

    @property
    def decided(self) -> set[tuple[tuple[str, str | None], tuple[str, str | None]]]:
        """Cause and alternative of each pair on which the motion is expected to decide."""
        if self.trajectory is None:
            return set()
        return {(p.cause, p.alternative) for p in self.pairs if p.decides}

    @property
    def worthwhile(self) -> bool:
        """Whether the motion is expected to decide any pair."""
        return self.trajectory is not None and any(pair.decides for pair in self.pairs)

    def to_dict(self, file: str) -> dict[str, Any]:
        """Return it as plain data; `file` is where the trajectory is written."""
        return {
            "file": file if self.worthwhile else None,
            "duration_s": self.seconds or None,
            "candidates": self.candidates,
            "pairs": [pair.to_dict() for pair in self.pairs],
            "notes": list(self.notes),
        }


@dataclass(frozen=True, repr=False)
class Diagnosis(Result):
    """The gap between a recording and a model, and its causes.

    Parameters
    ----------
    model, robot, joints, prismatic
        The arm and its model; prismatic joints use N for Nm and m for rad.
    identify, validate
        Sources of the recordings.
    independent_motion
        Whether the validation motion differs from the fitted motion.
    judged
        Recording -> interval used for validation, s.
    band
        Hz.
    trust
        Probability of each trust in the description.
    verdict
        "none", "explained" or "unknown".
    noise
        (joint, side) -> Nm.
    before, after
        Sizes on the validation data.
    shrink, shrink_interval, shrink_by_place
        Share of the gap that the causes remove, its 95 % interval, and the share at each joint
        and side; None without a gap.
    causes, unexplained
        Causes, most important first, and unexplained residuals.
    not_confirmed
        Causes that the fit suggests but the validation recordings do not confirm.
    imperfections
        Numbers of the description and of the sensors.
    made
        Joints whose motor torques are computed from commands and positions, or from their duty.
    of_duty
        Those of them whose torques are computed from their recorded duty.
    changes
        Sizes that differ between recordings.
    known
        Effects that belong to the model, with their sizes, as in `diagnosis.json`.
    events
        Intervals that contradict the rest of their recording, or in which all drives ignored
        their commands; they are excluded.
    notes
        Further information for the reader.
    prediction, proposal
        Prediction errors, and the motion that separates causes from their alternatives.
    closed_loop
        For an arm with commands: joint -> error under the recorded commands, for the description
        and for the written correction.
    taken_back
        Joints, and effects of the whole arm, whose corrections are not written.
    compared_scales
        Joint -> scale of its torques as diagnosed and as refined in closed loop.
    context
        Data for the figures; not saved.
    """

    _report = "elastic_arm.report.diagnosis"

    model: str
    robot: str
    joints: tuple[str, ...]
    identify: tuple[str, ...]
    validate: tuple[str, ...]
    independent_motion: bool
    judged: Mapping[str, tuple[float, float]]
    band: float
    trust: Mapping[str, float]
    verdict: str
    noise: Mapping[Place, float]
    before: ResidualSizes
    after: ResidualSizes
    shrink: float | None
    shrink_interval: tuple[float, float] | None
    shrink_by_place: Mapping[Place, float | None]
    causes: tuple[Cause, ...]
    unexplained: tuple[UnexplainedResidual, ...]
    not_confirmed: tuple[UnconfirmedCause, ...] = ()
    imperfections: tuple[Imperfection, ...] = ()
    made: tuple[str, ...] = ()
    of_duty: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    prismatic: tuple[str, ...] = ()
    known: tuple[Mapping[str, Any], ...] = ()
    events: tuple[Event, ...] = ()
    notes: tuple[str, ...] = ()
    prediction: Prediction | None = None
    proposal: Proposal | None = None
    closed_loop: Mapping[str, ClosedLoopError] = field(default_factory=dict)
    taken_back: tuple[str, ...] = ()
    compared_scales: Mapping[str, ComparedScale] = field(default_factory=dict)
    context: DiagnosisContext | None = field(default=None, repr=False, compare=False)

    @property
    def units(self) -> JointUnits:
        """Units of quantities at the joints."""
        return JointUnits(self.joints, self.prismatic)

    @property
    def torque_scale(self) -> dict[str, ParameterEstimate]:
        """Scale of the torques computed from commands or duty, true / described, by joint."""
        found = {p.joint: p for p in self.imperfections if p.what == SCALE}
        scales = {joint: found[joint] for joint in self.made if joint in found}
        return {joint: ParameterEstimate(one.value, one.std, "1") for joint, one in scales.items()}

    def with_closed_loop(
        self, errors: Mapping[str, ClosedLoopError], taken_back: Sequence[str]
    ) -> Diagnosis:
        """Return a copy with the closed-loop errors; a joint that moves worse prevents the verdict
        `explained`."""
        refused = any(one.refused is not None for one in errors.values())
        verdict = "unknown" if refused and self.verdict == "explained" else self.verdict
        causes = tuple(
            replace(one, rejected=(one.joint or one.effect) in taken_back) for one in self.causes
        )
        return replace(
            self,
            verdict=verdict,
            causes=causes,
            closed_loop=dict(errors),
            taken_back=tuple(taken_back),
        )

    def tables(self) -> dict[str, Sequence[Row]]:
        """Return the tables "causes" (one row per parameter), "gap" (one row per residual),
        "parameters" and "residuals" (over time)."""
        causes = [
            {
                "effect": c.effect,
                "joint": c.joint,
                "sides": "+".join(c.sides),
                "probability": c.confidence,
                "share_of_gap": c.shrink,
                "parameter": name,
                "value": e.value,
                "std": e.std,
                "unit": e.unit,
            }
            for c in self.causes
            for name, e in (c.parameters or {"": ParameterEstimate(None, None, "")}).items()
        ]
        sizes = {
            "rmse_before": self.before.rmse,
            "rmse_after": self.after.rmse,
            "max_before": self.before.peak,
            "max_after": self.after.peak,
            "own_gap_gone": self.shrink_by_place,
        }
        gap = [
            {
                "joint": joint,
                "side": side,
                "noise": noise,
                **{k: v.get((joint, side)) for k, v in sizes.items()},
            }
            for (joint, side), noise in self.noise.items()
        ]
        parameters = [{"recording": None, **one.to_dict()} for one in self.imperfections]
        return {
            "causes": causes,
            "gap": gap,
            "parameters": parameters,
            "residuals": self._residuals(),
        }

    def _residuals(self) -> list[Row]:
        if self.context is None:
            return []
        rows: list[Row] = []
        places = [
            f"{joint}.{side}"
            for side in self.context.validate.layout.sides
            for joint in self.joints
        ]
        names = [f"{place}.{when}" for when in ("before", "after") for place in places]
        for k, (source, (begin, _)) in enumerate(self.judged.items()):
            t, *residuals = self.context.over_time(k)
            values = zip((begin + t).tolist(), np.hstack(residuals).tolist(), strict=True)
            rows += [
                {"recording": source, "t": at, **dict(zip(names, row, strict=True))}
                for at, row in values
            ]
        return rows

    def residual_sides(self, source: str, start_ns: int) -> dict[str, Side]:
        """Return the residuals of a validation recording or of its parts as topics,
        `/residuals/motor/before`."""
        if self.context is None:
            return {}
        found: dict[str, list[Side]] = {}
        sides = self.context.validate.layout.sides
        for k, (name, (begin, _)) in enumerate(self.judged.items()):
            if name == source or name.startswith(f"{source}, "):
                t, *residuals = self.context.over_time(k)
                stamps = start_ns + np.round(1e9 * (begin + t)).astype(np.int64)
                for when, values in zip(("before", "after"), residuals, strict=True):
                    for side, own in zip(sides, np.hsplit(values, len(sides)), strict=True):
                        found.setdefault(f"/residuals/{side}/{when}", []).append(
                            Side(stamps, effort=own)
                        )
        return {topic: joined_sides(parts) for topic, parts in found.items()}

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
                "judged_s": plain(self.judged),
            },
            "band_hz": [0.0, plain(self.band)],
            "trust": plain(self.trust),
            "verdict": self.verdict,
            "noise": self._table(self.noise),
            "gap": {"before": self._sizes(self.before), "after": self._sizes(self.after)},
            "shrink": plain(self.shrink),
            "shrink_interval": plain(self.shrink_interval),
            "causes": [cause.to_dict() for cause in self.causes],
            "shrink_by_place": self._table(self.shrink_by_place),
            "imperfections": [one.to_dict() for one in self.imperfections],
            **self._commanded(),
            "changes": [one.to_dict() for one in self.changes],
            "unexplained": plain(self.unexplained),
            "not_confirmed": plain(self.not_confirmed),
            "known": [dict(one) for one in self.known],
            "events": plain(self.events),
            "notes": list(self.notes),
            "prediction": (
                None if self.prediction is None else self.prediction.to_dict(self.units.over("rad"))
            ),
            "next_motion": None if self.proposal is None else self.proposal.to_dict(SEPARATING),
        }

    def _commanded(self) -> dict[str, Any]:
        """Return the fields of arms with torques that are computed from commands or duties."""
        if not self.made:
            return {}
        scales = {}
        for name, e in self.torque_scale.items():
            scales[name] = {"value": plain(e.value), "std": plain(e.std)}
            if name in self.compared_scales:
                scales[name] |= self.compared_scales[name].to_dict()
        found: dict[str, Any] = {"torque_scale": scales}
        if self.of_duty:
            found["torque_of_duty"] = list(self.of_duty)
        if self.closed_loop:
            found["closed_loop"] = {name: one.to_dict() for name, one in self.closed_loop.items()}
            found["taken_back"] = list(self.taken_back)
        return found

    def save(self, path: str | Path) -> Path:
        """Write `diagnosis.json`.

        Raises a DiagnosisError if the file cannot be written.
        """
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False)
        return output_files.write_result(path, f"{text}\n", DiagnosisError, "Choose another --out")

    @staticmethod
    def load(path: str | Path, catalogue: Catalogue | None = None) -> Diagnosis:
        """Read a result that :meth:`save` wrote, and the proposed motion next to it; residuals over
        time are not saved.

        Raises a DiagnosisError if the file is not such a result.
        """
        remedy = "Give a diagnosis.json written by `elastic-arm diagnose`."
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise DiagnosisError(f"{path} cannot be read: {error}", remedy) from None
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            raise DiagnosisError(f"{path} is not a diagnosis", f"Its schema must be {SCHEMA}.")
        try:
            return from_dict(
                data, Path(path).parent, Catalogue.default() if catalogue is None else catalogue
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            what = f"{path} is not a complete diagnosis ({type(error).__name__}: {error})"
            raise DiagnosisError(what, remedy) from None

    def _table(self, values: Mapping[Place, float | None]) -> dict[str, Any]:
        return {
            joint: {side: plain(values.get((joint, side))) for side in SIDES}
            for joint in self.joints
        }

    def _sizes(self, size: ResidualSizes) -> dict[str, Any]:
        def cell(place: Place) -> dict[str, Any] | None:
            if place not in size.rmse:
                return None
            return {"rmse": plain(size.rmse[place]), "max": plain(size.peak[place])}

        return {joint: {side: cell((joint, side)) for side in SIDES} for joint in self.joints}


def from_dict(data: Mapping[str, Any], folder: Path, catalogue: Catalogue) -> Diagnosis:
    """Return the diagnosis that :meth:`Diagnosis.to_dict` gave; files that it names are in a
    folder."""
    # Most results are made, not read: what they hold besides is slow to import.
    from elastic_arm.diagnosis.prediction import Prediction

    def places(nested: Mapping[str, Any]) -> dict[Place, Any]:
        return {
            (joint, side): v for joint, by_side in nested.items() for side, v in by_side.items()
        }

    def sizes(when: str) -> ResidualSizes:
        there = {place: v for place, v in places(data["gap"][when]).items() if v is not None}
        return ResidualSizes(
            {p: v["rmse"] for p, v in there.items()}, {p: v["max"] for p, v in there.items()}
        )

    noise = {place: v for place, v in places(data["noise"]).items() if v is not None}
    recordings = data["recordings"]
    interval = data["shrink_interval"]
    scales = data.get("torque_scale", {})
    compared = {name: ComparedScale.from_dict(one) for name, one in scales.items()}
    prediction = data["prediction"]
    changes = [
        {**one, "values": tuple(map(_change_value, one["values"]))} for one in data["changes"]
    ]
    return Diagnosis(
        **{name: data[name] for name in ("model", "robot", "verdict", "trust", "shrink")},
        joints=tuple(data["noise"]),
        prismatic=tuple(data.get("prismatic", ())),
        identify=tuple(recordings["identify"]),
        validate=tuple(recordings["validate"]),
        independent_motion=recordings["independent_motion"],
        judged={name: tuple(span) for name, span in recordings["judged_s"].items()},
        band=data["band_hz"][1],
        noise=noise,
        before=sizes("before"),
        after=sizes("after"),
        shrink_interval=None if interval is None else tuple(interval),
        shrink_by_place={
            place: v for place, v in places(data["shrink_by_place"]).items() if place in noise
        },
        causes=tuple(_cause(one, catalogue) for one in data["causes"]),
        unexplained=tuple(UnexplainedResidual(**one) for one in data["unexplained"]),
        not_confirmed=tuple(UnconfirmedCause(**one) for one in data.get("not_confirmed", ())),
        imperfections=tuple(
            Imperfection(**one, neutral=float(one["unit"] == "1")) for one in data["imperfections"]
        ),
        made=tuple(scales),
        of_duty=tuple(data.get("torque_of_duty", ())),
        closed_loop={
            name: ClosedLoopError.from_dict(one)
            for name, one in data.get("closed_loop", {}).items()
        },
        taken_back=tuple(data.get("taken_back", ())),
        compared_scales={name: one for name, one in compared.items() if one is not None},
        changes=tuple(Change(**one) for one in changes),
        known=tuple(data["known"]),
        events=tuple(Event(**one) for one in data.get("events", ())),
        notes=tuple(data["notes"]),
        prediction=None if prediction is None else Prediction.from_dict(prediction),
        proposal=None if data["next_motion"] is None else _proposal(data["next_motion"], folder),
    )


def _cause(one: Mapping[str, Any], catalogue: Catalogue) -> Cause:
    effect = catalogue.find(one["effect"])
    given = one["parameters"]
    values = {
        name: tuple(v) if isinstance(v := p["value"], list) else v for name, p in given.items()
    }
    side = {"side": one["sides"][0]} if "side" in effect.names else {}
    return Cause(
        **{name: one[name] for name in ("effect", "joint", "regime", "shrink", "confidence")},
        sides=tuple(one["sides"]),
        parameters={
            p.name: ParameterEstimate(**given[p.name] | ({"std": 0.0} if p.integer else {}))
            for p in effect.parameters
            if p.name in given
        },
        alternatives=tuple(Alternative(**a) for a in one["alternatives"]),
        instance=EffectInstance(effect, one["joint"], {**values, **side}),
        stated=one["from"],
        is_number=one["held_as"] == "number",
        shrink_without=one.get("shrink_without"),
        rejected=one.get("rejected", False),
    )


def _change_value(one: Mapping[str, Any]) -> tuple[str, float, float]:
    return one["recording"], one["value"], one["std"]


def _proposal(data: Mapping[str, Any], folder: Path) -> Proposal:
    from elastic_arm.excitation import load_trajectory

    def place(one: Mapping[str, Any]) -> tuple[str, str | None]:
        return one["effect"], one["joint"]

    pairs = []
    for pair in data["pairs"]:
        here = pair["log_likelihood"]["this_recording"]
        expected = pair["log_likelihood"]["proposed"]
        pairs.append(
            PairSeparation(
                place(pair["cause"]), place(pair["alternative"]), here, expected, pair["decides"]
            )
        )
    trajectory = (
        load_trajectory(folder / data["file"])
        if data["file"] and (folder / data["file"]).exists()
        else None
    )
    return Proposal(trajectory, tuple(pairs), data["candidates"], tuple(data["notes"]))
