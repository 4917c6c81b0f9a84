"""Effects, sizes, shares and probabilities as text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from elastic_arm.formatting import JointUnits, rounded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
    from elastic_arm.effects import EffectInstance

DOUBT = 0.001  # that stays with every confidence and every alternative


def effect_at(effect: str, joint: str | None) -> str:
    """Return an effect with its place."""
    return f"{effect} on {joint or 'the whole arm'}"


def estimates_text(parameters: Mapping[str, ParameterEstimate], between: str = ", ") -> str:
    """Return parameters with standard deviations and units as text; what is whole or given has no deviation."""
    return between.join(f"{name} {size_text(e.value, e.std, e.unit)}" for name, e in parameters.items())


def instance_text(instance: EffectInstance, units: JointUnits) -> str:
    """Return all that an effect was given, with the units at its joint.

    Parameters
    ----------
    instance
        On a joint, or the whole arm.
    units
        Of the arm.
    """
    given, joint = instance.parameters, instance.joint
    numbers = [f"{p.name} {size_text(given[p.name], 0.0, units.at(joint, p.unit))}" for p in instance.effect.parameters]
    choices = [f"{c.name} {chosen(given[c.name])}" for c in instance.effect.choices]
    return ", ".join([*numbers, *choices])


def percent(share: float | None) -> str:
    """Return a share of the gap as text; none is zero."""
    return f"{round(100 * (share or 0.0), 1) + 0.0:.1f} %"  # + 0.0: no "-0.0"


def probability_text(probability: float) -> str:
    """Return a probability as text that never claims certainty."""
    if not DOUBT <= probability <= 1.0 - DOUBT:
        return f"< {percent(DOUBT)}" if probability < DOUBT else f"> {percent(1.0 - DOUBT)}"
    return f"{100 * probability:.{0 if 0.01 <= probability <= 0.99 else 1}f} %"


def log_likelihood_text(value: float) -> str:
    """Return a log-likelihood with two digits; differences below a tenth are none."""
    if value < 0.1:
        return "0"
    if value < 100.0:
        return f"{value:.2g}"
    two_digits = float(f"{value:.2g}")
    return f"{two_digits:,.0f}".replace(",", "\u202f")


def listed(names: Sequence[str], more: int = 0) -> str:
    """Return names as a list in a sentence, the last one being how many more there are."""
    names = [*names, f"{more} more"] if more > 0 else names
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def chosen(value: object) -> str:
    """Return what was chosen of an effect, such as its channels."""
    return " and ".join(value) if isinstance(value, tuple) else str(value)


def size_text(value: Any, std: Any, unit: str = "1") -> str:
    """Return a number, or a vector of them, with its unit and the digits that its standard deviation warrants.

    Parameters
    ----------
    value
        A number, or a list of them.
    std
        Of each; zero where it is given, None where it is not known.
    unit
        "1" for a ratio.
    """
    vector = isinstance(value, list | tuple)
    values = list(value) if vector else [value]
    stds = list(std) if isinstance(std, list | tuple) else [std] * len(values)
    parts = zip(*(_pair(v, s) for v, s in zip(values, stds, strict=True)), strict=True)
    number, deviation = (f"({', '.join(part)})" if vector else part[0] for part in parts)
    size = number if all(s == 0.0 for s in stds) else f"{number} ± {deviation}"
    return size if unit == "1" else f"{size} {unit}"


def _pair(value: float, std: float | None) -> tuple[str, str]:
    return (f"{value:.4g}", "?") if std is None else rounded(value, std)
