"""The gap between a recording and a model: where it lies, which effect causes it, how far it shrinks, what next.

    from elastic_arm.diagnosis import Question, diagnose

    found = diagnose([recording], Question(robot), [another])

Names are loaded when they are first used: commands that only format a result import no search.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from elastic_arm.diagnosis.pipeline import diagnose, follow_up
    from elastic_arm.diagnosis.question import Question
    from elastic_arm.diagnosis.result import Diagnosis
    from elastic_arm.diagnosis.settings import DiagnosisSettings

__all__ = ["Diagnosis", "DiagnosisSettings", "Question", "diagnose", "follow_up"]

_MODULES = {
    "Diagnosis": "result",
    "DiagnosisSettings": "settings",
    "Question": "question",
    "diagnose": "pipeline",
    "follow_up": "pipeline",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
