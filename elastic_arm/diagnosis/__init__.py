"""The gap between a recording and a model: where it lies, which effect causes it, how far it
shrinks, what next.

    from elastic_arm.diagnosis import Question, diagnose

    found = diagnose([recording], Question(robot), [another])

Names are loaded when they are first used: commands that only format a result import no search.
"""

from typing import TYPE_CHECKING

from elastic_arm.lazy_names import lazily

if TYPE_CHECKING:
    from elastic_arm.diagnosis.answer import diagnose
    from elastic_arm.diagnosis.following_up import follow_up
    from elastic_arm.diagnosis.question import Question
    from elastic_arm.diagnosis.result import Diagnosis
    from elastic_arm.evidence.priors import Priors

__all__ = ["Diagnosis", "Priors", "Question", "diagnose", "follow_up"]

_MODULES = {
    "Diagnosis": "elastic_arm.diagnosis.result",
    "Priors": "elastic_arm.evidence.priors",
    "Question": "elastic_arm.diagnosis.question",
    "diagnose": "elastic_arm.diagnosis.answer",
    "follow_up": "elastic_arm.diagnosis.following_up",
}

__getattr__, __dir__ = lazily(__name__, _MODULES)
