"""The sums of a stream on disk: an npz file of plain arrays, and a header in JSON with the model they belong to."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.noise import SideNoise
from elastic_arm.estimation.resampling import Clock
from elastic_arm.estimation.smoother import Smoother
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Blocks
from elastic_arm.identification.verdict import MotionStatistics
from elastic_arm.output_files import write_result

Array = NDArray[np.float64]
SCHEMA = "elastic_arm/identifier/1"


# Channels by joint.
Recorded = tuple[frozenset[str], ...]


class Sums(NamedTuple):
    """The sums of a stream, as they are saved.

    Parameters
    ----------
    recorded
        Names of the channels of each joint.
    averaged
        Whether they are of averages of rows.
    blocks, statistics
        The sums.
    progress
        Counts of samples, by name.
    smoother, clock
        Of the derivative stage; None where motion with derivatives was added.
    """

    recorded: Recorded
    averaged: bool
    blocks: Blocks
    statistics: MotionStatistics
    progress: dict[str, int]
    smoother: Smoother | None
    clock: Clock | None


def write_sums(path: str | Path, equations: BaseRegression, sums: Sums) -> None:
    """Write sums to an npz file.

    Parameters
    ----------
    path
        Of the file.
    equations
        That the sums are of: their names are saved beside them.
    sums
        Of a stream.

    Raises
    ------
    IdentificationError
        If the file cannot be written.
    """
    blocks = sums.blocks
    head = {
        "schema": SCHEMA,
        **_identity(equations),
        "averaged": sums.averaged,
        "recorded": [sorted(channels) for channels in sums.recorded],
        "span": blocks.span,
        "counts": blocks.counts,
        "progress": sums.progress,
        "statistics": _plain(asdict(sums.statistics)),
        "smoother": None if sums.smoother is None else _plain(asdict(sums.smoother)),
        "clock": None if sums.clock is None else asdict(sums.clock),
    }
    hi, lo = (np.array([gram[k] for gram in blocks.grams]) for k in (0, 1))
    packed = io.BytesIO()
    np.savez(packed, head=np.array(json.dumps(head)), hi=hi, lo=lo, known_noise=np.array(blocks.known_noise))
    write_result(path, packed.getvalue(), IdentificationError, "Choose another folder.")


def recorded_in(path: str | Path) -> Recorded:
    """Return the channels of the samples whose sums were saved; see :func:`read_sums` for errors."""
    return _recorded(_read(path)[0])


def _recorded(head: dict[str, Any]) -> Recorded:
    """Return the channels by joint; files of the first releases hold one list for all joints."""
    saved = head["recorded"]
    return tuple(map(frozenset, saved if saved and isinstance(saved[0], list) else [saved] * len(head["joints"])))


def read_sums(path: str | Path, equations: BaseRegression, *, averaged: bool) -> Sums:
    """Read sums of the same equations.

    Parameters
    ----------
    path
        Of the file.
    equations
        That the sums must be of.
    averaged
        Whether they must be of averages of rows.

    Raises
    ------
    IdentificationError
        If the file holds no sums, or those of other equations: another arm, model, or laws, or averaged otherwise.
    """
    head, arrays = _read(path)
    for what, own in _identity(equations).items():
        if head[what] != own:
            saved, wanted = (v if isinstance(v, str) else ", ".join(v) or "none" for v in (head[what], own))
            raise IdentificationError(
                f"{path} holds sums of {what.replace('_', ' ')} {saved}, not {wanted}",
                "Load them into an identifier of the same arm, model and laws.",
            )
    # Files of the first releases do not say it; only those of rigid arms can hold averages.
    if head.get("averaged", None if equations.rigid else False) != averaged:
        known = {True: "averages of rows", False: "rows as they were sampled", None: "rows averaged or not"}
        raise IdentificationError(
            f"{path} holds sums of {known[head.get('averaged')]}, not of {known[averaged]}",
            "Load them into an identifier with the same `averaged`, or identify anew where the file does not say it.",
        )
    blocks = Blocks(len(equations.groups), len(equations.base) + 1, span=head["span"])
    blocks.grams = list(zip(arrays["hi"], arrays["lo"], strict=True))
    blocks.known_noise = list(arrays["known_noise"])
    blocks.counts = head["counts"]
    blocks.close()
    smoother, clock = head["smoother"], head["clock"]
    # Files of the first releases call them by another name.
    statistics = head["statistics"] if "statistics" in head else head["liveliness"]
    return Sums(
        _recorded(head),
        averaged,
        blocks,
        MotionStatistics(**{name: _array(value) for name, value in statistics.items()}),
        head["progress"],
        None if smoother is None else _smoother(smoother),
        None if clock is None else Clock(**clock),
    )


def _identity(equations: BaseRegression) -> dict[str, Any]:
    """Return what must agree: then the base parameters do, too, up to the numbers of the description."""
    return {
        "robot": equations.model.robot.name,
        "model": equations.model.name,
        "joints": list(equations.joints),
        "laws": [column.name for column in equations.columns],
        "equations": list(equations.sides),
        "base_parameters": list(equations.base.names),
    }


def _read(path: str | Path) -> tuple[dict[str, Any], dict[str, Array]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            head = json.loads(str(file["head"]))
            arrays = {name: file[name] for name in ("hi", "lo", "known_noise")}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise IdentificationError(f"{path} holds no sums of an identifier: {error}", "Give a file it saved.") from None
    if head.get("schema") != SCHEMA:
        raise IdentificationError(f"{path} holds no sums of an identifier", f"Its schema must be {SCHEMA}.")
    return head, arrays


def _smoother(saved: dict[str, Any]) -> Smoother:
    kept: dict[str, Any] = {name: _array(value) for name, value in saved.items()}
    for side in ("link_noise", "motor_noise"):
        if kept[side] is not None:
            kept[side] = SideNoise(**{name: _array(value) for name, value in kept[side].items()})
    return Smoother(**kept)


def _plain(value: Any) -> Any:
    """Return it for JSON, which keeps every digit; Python writes and reads infinity."""
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


def _array(value: Any) -> Any:
    return np.array(value, dtype=float) if isinstance(value, list) else value
