"""The hidden arms of the challenge share nothing with what diagnoses them, held by reading their imports."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.test_architecture import PACKAGE, imports_of

CHALLENGE = "elastic_arm.studies.blind_challenge."
# What an arm is described by, what a recording is, and what compiles C: no physics.
NEUTRAL = ("elastic_arm.errors.", "elastic_arm.robot.", "elastic_arm.recording.", "elastic_arm.codegen.kernels")
MAKERS = ("tree", "recursion", "laws", "instruments", "motion", "engine", "hidden_arm")


@pytest.mark.parametrize("name", MAKERS)
def test_what_makes_a_hidden_arm_knows_neither_catalogue_nor_models(name: str) -> None:
    """Neither laws nor dynamics nor anything of the diagnosis stands behind a hidden recording."""
    makers = tuple(CHALLENGE + other for other in MAKERS)
    own = [full for _, full in imports_of(PACKAGE / "gap" / "challenge" / f"{name}.py")]
    shared = [full for full in own if full.startswith("elastic_arm.") and not full.startswith((*NEUTRAL, *makers))]
    assert not shared


@pytest.mark.parametrize("path", sorted((PACKAGE / "gap").glob("*.py")), ids=lambda path: path.stem)
def test_no_diagnosis_looks_into_the_challenge(path: Path) -> None:
    """What answers imports nothing of the challenge, so that no truth can reach an answer."""
    assert not [full for _, full in imports_of(path) if full.startswith(CHALLENGE.rstrip("."))]
