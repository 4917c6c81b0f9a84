"""Findings about a recording, and all of them together."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from elastic_arm.errors import one_line

FEWEST = 200  # samples; of fewer nothing is concluded
Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """Something found in a bag or a recording."""

    # "error": it cannot be used as it is; "warning": it can, with less accuracy; "note": good to know
    severity: Severity
    code: str  # A word for scripts
    message: str  # For people
    topic: str | None = None  # Where, as far as it is of one place; seconds from the first sample
    joint: str | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        # Names come out of bags.
        object.__setattr__(self, "message", one_line(self.message))


def warning(code: str, message: str, remedy: str = "") -> Finding:
    """Return a warning, with what to do about it."""
    return Finding("warning", code, f"{message}: {remedy}" if remedy else message)


@dataclass
class Report:
    """All findings about a bag."""

    path: str
    findings: list[Finding] = field(default_factory=list)
    begin_ns: int | None = None  # of what was looked at

    @property
    def ok(self) -> bool:
        """Whether nothing worse than a note was found."""
        return all(finding.severity == "note" for finding in self.findings)

    @property
    def usable(self) -> bool:
        """Whether it can be read and used, if with less accuracy."""
        return all(finding.severity != "error" for finding in self.findings)

    def add(self, severity: Severity, code: str, message: str, **where: Any) -> None:
        """Add a finding with its place: topic, joint, time."""
        self.findings.append(Finding(severity, code, message, **where))

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {"path": self.path, "ok": self.ok, "findings": [asdict(finding) for finding in self.findings]}
