"""The search for events in the residuals that the most probable set leaves.

All recordings share numbers and effects, so a size that differs only in the validation recordings
is not an event. Each recording is searched as a whole: the fitted part, then the validation part.
"""

from dataclasses import replace

from elastic_arm.diagnosis.decomposition import Decomposition
from elastic_arm.diagnosis.events import Blocks, Event, blocks_of, events_of
from elastic_arm.evidence.problem import FITTED


def events_in(parts: Decomposition) -> tuple[Event, ...]:
    """Return the stretches that contradict the rest of their recordings."""
    whole = replace(parts, by_all=True, prepared=parts.prepared.without(()))
    looks = replace(whole, which=FITTED), whole
    problem = whole.problem
    found: list[Event] = []
    for number, source in problem.sources.items():
        blocks: list[Blocks] = []
        for look, own in zip(looks, problem.indices, strict=True):
            if number in own:
                begin = whole.prepared.begins[look.which][source]
                left = look.after
                blocks += blocks_of(look.linear, left, own.index(number), begin)
        found += events_of(blocks, source, whole.places, problem.layout.live)
    return tuple(found)
