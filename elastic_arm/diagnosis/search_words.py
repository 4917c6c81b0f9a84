"""The search of a diagnosis in words, for `diagnose --explain`: sets, missing terms, and moves."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from elastic_arm.estimation.equation_sets import Place
from elastic_arm.evidence.explanation import Explanation
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.gauss_newton import linear_model
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.relinearise import pool_of
from elastic_arm.evidence.screen import Screen

# that are listed
SETS = 5
TERMS = 8
AT_JOINT = 3
NOTHING = "no term"


def search_words(explanation: Explanation, reasons: Mapping[Place, Sequence[str]]) -> list[str]:
    """Return lines on the sets, the unexplained residuals, the terms with the largest gains, and
    the moves of a search.

    reasons: why each residual counts as unexplained.
    """
    lacking = list(_lacking(explanation))
    lines = ["sets of terms, by probability, with the difference of each from the best:"]
    lines += _sets(explanation)
    for (joint, side), own in reasons.items():
        lines.append(f"unexplained at {joint}, {side} side: {'; '.join(own)}")
        at_joint = [line for line, key in lacking if key[1] in (joint, None)]
        lines += at_joint[:AT_JOINT]
    lines.append("terms outside the best set, by gain (negative: the prior outweighs it):")
    lines += [line for line, _ in lacking[:TERMS]]
    lines.append("moves:")
    lines += [f"  {line}" for line in explanation.log]
    return lines


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


def _lacking(explanation: Explanation) -> Iterator[tuple[str, Key]]:
    """Yield the gain of each term outside the best set and its key, the largest gain first."""
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
        yield f"  {gains[k]:+8.1f} nats  {_named(explanation, key)}", key


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
