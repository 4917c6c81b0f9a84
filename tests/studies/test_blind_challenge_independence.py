"""The hidden arms of the challenge share nothing with what diagnoses them, held by reading their imports."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.test_architecture import PACKAGE, imports_of

STUDY = "elastic_arm.studies.blind_challenge"
HIDDEN_ARMS = f"{STUDY}.hidden_arms."
# What an arm is described by, what a recording is, and what compiles C: no physics.
NEUTRAL = ("elastic_arm.errors.", "elastic_arm.robot.", "elastic_arm.recording.", "elastic_arm.codegen.kernels")
HIDDEN = sorted((PACKAGE / "studies" / "blind_challenge" / "hidden_arms").glob("*.py"))
DIAGNOSING = ("codegen", "dynamics", "effects", "estimation", "identification", "diagnosis")
ANSWERING = sorted(path for package in DIAGNOSING for path in (PACKAGE / package).rglob("*.py"))


@pytest.mark.parametrize("path", HIDDEN, ids=lambda path: path.stem)
def test_what_makes_a_hidden_arm_knows_neither_catalogue_nor_models(path: Path) -> None:
    """Neither laws nor dynamics nor anything of the diagnosis stands behind a hidden recording."""
    own = [full for _, full in imports_of(path) if full.startswith("elastic_arm.")]
    assert not [full for full in own if not full.startswith((*NEUTRAL, HIDDEN_ARMS))]


@pytest.mark.parametrize("path", ANSWERING, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_diagnosis_looks_into_the_challenge(path: Path) -> None:
    """What answers imports nothing of the challenge, so that no truth can reach an answer."""
    assert not [full for _, full in imports_of(path) if full.startswith(STUDY)]


def test_the_modules_read_are_there() -> None:
    """Both rules are held over modules that exist."""
    assert len(HIDDEN) >= 7 and len(ANSWERING) > 40
