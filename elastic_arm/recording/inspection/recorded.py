"""All findings about the numbers of a recording: for the check, and as notes for the commands that fit."""

from __future__ import annotations

from elastic_arm.recording.inspection.described_gravity import contradicted_gravity
from elastic_arm.recording.inspection.magnitudes import beyond_limits
from elastic_arm.recording.inspection.outliers import cleared
from elastic_arm.recording.inspection.plausibility import implausible
from elastic_arm.recording.inspection.report import Finding
from elastic_arm.recording.inspection.stuck_channels import channel_findings, frozen
from elastic_arm.recording.inspection.two_encoders import disagreeing
from elastic_arm.recording.recording import Recording
from elastic_arm.robot import Robot


def looked_through(recording: Recording, robot: Robot | None = None) -> list[Finding]:
    """Return what had to be done to use a recording, and what no sensors of a moving arm, or of this one, measure."""
    whole, found = cleared(recording)
    found += [Finding("note", "reading", note) for note in whole.samples().notes if note not in recording.notes]
    return found + _seen(whole, recording, robot)


def doubts(recording: Recording, robot: Robot) -> list[str]:
    """Return in words what cannot be right of a recording to be fitted; fits look for the mounting themselves."""
    found = _seen(cleared(recording)[0], recording, robot)
    return [finding.message for finding in found if finding.severity == "warning" and finding.code != "mounting"]


def _seen(whole: Recording, recording: Recording, robot: Robot | None) -> list[Finding]:
    found = [*channel_findings(whole), *frozen(recording), *implausible(whole), *disagreeing(whole)]
    return found if robot is None else [*found, *beyond_limits(whole, robot), *contradicted_gravity(whole, robot)]
