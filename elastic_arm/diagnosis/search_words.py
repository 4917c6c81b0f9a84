"""The search of a diagnosis in words, for `diagnose --explain`: the sets that were scored, what the
best one lacks, and the moves."""

from collections.abc import Iterator

import numpy as np

from elastic_arm.evidence.explanation import Explanation
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.gauss_newton import linear_model
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.relinearise import pool_of
from elastic_arm.evidence.screen import Screen

# that are listed
SETS = 5
TERMS = 8
NOTHING = "no term"


def search_words(explanation: Explanation) -> list[str]:
    """Return lines on the sets, the terms that would gain most, and the moves of a search."""
    return [
        "sets of terms, by probability, with the difference of each from the best:",
        *_sets(explanation),
        "terms outside the best set, by gain (negative: the prior outweighs it):",
        *_lacking(explanation),
        "moves:",
        *(f"  {line}" for line in explanation.log),
    ]


def _sets(explanation: Explanation) -> Iterator[str]:
    together: dict[frozenset[Key], float] = {}
    best: dict[frozenset[Key], float] = {}
    for p, fit in explanation.sets:
        together[fit.keys] = together.get(fit.keys, 0.0) + p
        best[fit.keys] = max(best.get(fit.keys, -np.inf), fit.score)
    first = max(best.values())
    for keys in sorted(together, key=lambda keys: -together[keys])[:SETS]:
        behind = first - best[keys]
        terms = ", ".join(sorted(_named(explanation, key) for key in keys)) or NOTHING
        yield f"  {together[keys]:6.1%}  {behind:6.1f} nats behind  {terms}"


def _lacking(explanation: Explanation) -> Iterator[str]:
    best: Fit = explanation.best
    model = linear_model(explanation.linear, best.model.assumed)
    screen = Screen(model.grams, pool_of(explanation.linear))
    gains = screen.gains(best)
    listed: set[Key] = set(best.keys)
    for k in np.argsort(-gains):
        key = screen.terms[k].key
        if key in listed or not np.isfinite(gains[k]):
            continue
        listed.add(key)
        yield f"  {gains[k]:+8.1f} nats  {_named(explanation, key)}"
        if len(listed) == len(best.keys) + TERMS:
            return


def _named(explanation: Explanation, key: Key) -> str:
    effect, joint, choices = key
    if effect == "law":
        side, argument, smoothness = choices
        name = explanation.linear.problem.robot.joint_names[int(str(joint))]
        return f"{smoothness} law of {argument} on {name} ({side})"
    chosen = [str(choice[1]) if isinstance(choice, tuple) else str(choice) for choice in choices]
    where = f" on {joint}" if joint else ""
    how = f" ({', '.join(chosen)})" if chosen else ""
    return f"{effect}{where}{how}"
