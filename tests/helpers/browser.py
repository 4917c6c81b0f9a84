"""A headless Chromium for tests that open a report as its reader would."""

import shutil
import subprocess
from pathlib import Path

import pytest

_OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--virtual-time-budget=2000",
]


def rendered_page(report: Path, profile: Path) -> str:
    """Return the page's document after the browser has laid it out."""
    browser = (
        shutil.which("chromium")
        or shutil.which("chromium-browser")
        or shutil.which("google-chrome")
    )
    if browser is None:
        pytest.skip(
            "no Chromium on this machine: the test that opens a report in a browser needs one"
        )
    command = [
        browser,
        *_OPTIONS,
        f"--user-data-dir={profile}",
        "--dump-dom",
        report.resolve().as_uri(),
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
