"""The gate of pipelines: results of a diagnosis with which a command ends with exit status 1."""

import re
from collections.abc import Iterator, Sequence
from typing import Annotated

import typer
from rich.markup import escape

from elastic_arm.cli.console import err
from elastic_arm.diagnosis.result import Cause, Change, Diagnosis
from elastic_arm.errors import DiagnosisError

VERDICTS = ("unknown", "explained")
_CHANGE = re.compile(r"change:(\d+(?:\.\d+)?)%")

FailOn = Annotated[
    list[str] | None,
    typer.Option(
        "--fail-on",
        metavar="unknown|explained|change:P%",
        help=(
            "Exit with status 1 for this verdict, or if a size differs by more than P % between"
            " recordings or from the stated value. May be repeated."
        ),
    ),
]


def check_gate(gates: Sequence[str]) -> None:
    """Refuse what is no gate, before the work."""
    for gate in gates:
        if gate not in VERDICTS and not _CHANGE.fullmatch(gate):
            raise DiagnosisError(
                f"--fail-on {gate!r} is not valid",
                f"Give {' or '.join(VERDICTS)}, or a change such as change:5%.",
            )


def pass_gate(found: Diagnosis, gates: Sequence[str]) -> None:
    """End with exit status 1 if a diagnosis fails at a gate, and say at which on stderr."""
    failed = [words for gate in gates for words in _failures(found, gate)]
    for words in failed:
        err.print(f"[bold red]failed:[/] {escape(words)}", soft_wrap=True)
    if failed:
        raise typer.Exit(1)


def _failures(found: Diagnosis, gate: str) -> Iterator[str]:
    if gate in VERDICTS and found.verdict == gate:
        yield f"the verdict is {gate}"
    if (limit := _CHANGE.fullmatch(gate)) is not None:
        sizes: list[Change | Cause] = [*found.changes, *found.causes]
        for one in sizes:
            size = _relative(one)
            if size > float(limit[1]) / 100.0:
                yield (
                    f"{one.effect} of {one.joint or 'the whole arm'} changed by"
                    f" {100.0 * size:.3g} %"
                )


def _relative(one: Change | Cause) -> float:
    """Return by how much a size differs: of the first recording's, or of what is stated; none where
    nothing is."""
    if isinstance(one, Change):
        values = [value for _, value, _ in one.values]
        return max(abs(value - values[0]) for value in values) / max(abs(values[0]), 1e-300)
    stated = one.stated or {}
    pairs = [
        (one.parameters[name].value, value)
        for name, value in stated.items()
        if name in one.parameters
    ]
    return max((abs(now - before) / max(abs(before), 1e-300) for now, before in pairs), default=0.0)
