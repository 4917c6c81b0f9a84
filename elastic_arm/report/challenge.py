"""The report of a challenge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from elastic_arm.report.html import write_report


def write_challenge_report(path: str | Path, found: dict[str, Any]) -> Path:
    """Write it."""
    return write_report(path, "Challenge", [])
