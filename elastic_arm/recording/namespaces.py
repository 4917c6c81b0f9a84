"""Which arm of a bag: topics of an arm in the namespace /left are /left/joint_states and so on."""

from __future__ import annotations

from collections.abc import Sequence

from elastic_arm.errors import RecordingError
from elastic_arm.recording.storage.bag import Bag
from elastic_arm.recording.storage.messages import topics_of
from elastic_arm.recording.topics import JOINT_STATES, MOTOR_STATES, TYPES


def choose_namespace(bags: Sequence[Bag], wanted: str | None = None) -> str:
    """Return the namespace of the arm to read, "" for the root.

    Where none is asked for, it is that of the topics without a namespace if they are there, and otherwise the only one
    that holds states.
    """
    found = sorted(
        {
            topic.name.removesuffix(states)
            for bag in bags
            for topic in topics_of(bag.files)
            for states in (JOINT_STATES, MOTOR_STATES)
            if topic.name.endswith(states) and topic.type_name == TYPES[states]
        }
    )
    if wanted is None:
        if len(found) > 1 and "" not in found:
            source = ", ".join(str(bag.path) for bag in bags)
            raise RecordingError(f"{source} holds {len(found)} arms: {', '.join(found)}", "Choose one: --namespace.")
        return found[0] if found else ""
    namespace = f"/{wanted.strip('/')}".rstrip("/")
    if namespace not in found:
        source = ", ".join(str(bag.path) for bag in bags)
        held = ", ".join(name or "/" for name in found) or "none"
        raise RecordingError(f"{source} holds no arm in the namespace {namespace or '/'}", f"There are: {held}.")
    return namespace


def local_name(topic: str, namespace: str) -> str | None:
    """Return the name of a topic within a namespace; None for a topic outside of it."""
    if not namespace:
        return topic
    return topic.removeprefix(namespace) if topic.startswith(f"{namespace}/") else None
