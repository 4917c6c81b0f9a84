"""The steps of a diagnosis, from recordings to result.

    prepare -> explain -> exclude events, and explain again -> confirm -> result

Each step has its module: :mod:`.preparation`, :mod:`elastic_arm.evidence.relinearise`,
:mod:`.event_search`, :mod:`.confirmed_set`, :mod:`.outcome`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits

from elastic_arm.diagnosis.confirmed_set import confirmed
from elastic_arm.diagnosis.decomposition import Decomposition
from elastic_arm.diagnosis.event_search import events_in
from elastic_arm.diagnosis.first_look import FirstLook, first_look
from elastic_arm.diagnosis.outcome import diagnosis_of
from elastic_arm.diagnosis.preparation import Prepared, prepare
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.errors import DiagnosisError, require_kind
from elastic_arm.evidence.explanation import Explanation
from elastic_arm.evidence.problem import ALL
from elastic_arm.evidence.relinearise import explain
from elastic_arm.evidence.watch import Stage, Watch
from elastic_arm.formatting import counted
from elastic_arm.recording import Recording
from elastic_arm.recording.made_torque import at_common_gain, with_recorded_duty
from elastic_arm.recording.recording import recordings_of

AGAIN = 3  # times that recordings are explained anew without the events that are found
AFTER_EVENTS = 0.5  # share of a search that is typically done when its events are found


# More threads wait for each other, and take thirty times as long.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    recordings: Sequence[Recording],
    question: Question,
    validate: Sequence[Recording] = (),
    *,
    watch: Watch | None = None,
) -> Diagnosis:
    """Find where recordings and model differ, which effects cause it, and by how much the gap
    shrinks with them.

    Parameters
    ----------
    recordings
        Recordings on which causes are fitted.
    question
        Arm, model, known effects, catalogue and priors.
    validate
        Recordings for validation; by default the last third of each recording.
    watch
        Receives the stages and can end the search, which then returns the best answer so far.

    Raises
    ------
    DiagnosisError
        If the recordings allow no diagnosis: no torque, no motion, too short, validation equal to
        identification data.
    RecordingError
        If a recording lacks a joint, has another type, or contains implausible numbers.
    """
    recordings = recordings_of(recordings)
    validate = recordings_of(validate, "validate")
    require_kind(question, Question, "question", DiagnosisError, "Give Question(robot).")
    robot = at_common_gain(question.robot, [*recordings, *validate])
    question = replace(question, robot=with_recorded_duty(robot, [*recordings, *validate]))
    watch = watch or Watch()
    prepared = prepare(recordings, validate, question)
    each = [*recordings, *validate]
    seconds = sum(one.duration for one in each)
    watch.say(f"{seconds:.0f} s of {len(each)} recordings read and checked", Stage.CHECKED)
    parts = _explained(prepared, question, watch, _viewer(prepared, question, watch.show))
    # Events may come back that were left out before, and with them the answer.
    known = {prepared.events: parts}
    for _ in range(AGAIN):
        events = events_in(parts)
        if events == parts.prepared.events or watch.is_over():
            break
        words = f"{counted(len(events), 'event')} excluded, and the search repeated without"
        watch.say(words, Stage.CAUSES, AFTER_EVENTS)
        if events not in known:
            known[events] = _explained(prepared.without(events), question, watch)
        parts = known[events]
        # The torques that act in them are those that were found now.
        parts = replace(parts, prepared=replace(parts.prepared, events=events))
    watch.say("confirmation on the validation recordings", Stage.CONFIRMED)
    return diagnosis_of(confirmed(parts))


Look = Callable[[Explanation], None]


def _viewer(
    prepared: Prepared, question: Question, show: Callable[[FirstLook], None] | None
) -> Look | None:
    """Return what shows the first look at the recordings; None where nobody looks."""
    if show is None:
        return None
    return lambda usual: show(
        first_look(Decomposition(prepared, usual, question, ALL, by_all=True))
    )


def _explained(
    prepared: Prepared, question: Question, watch: Watch, look: Look | None = None
) -> Decomposition:
    """Find the sets of terms, and decompose the residuals by the most probable one."""
    explanation = explain(prepared.problem, refit=question.refit, watch=watch, look=look)
    return Decomposition(prepared, explanation, question)
