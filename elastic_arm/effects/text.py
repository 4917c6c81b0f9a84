"""Effects that the user knows, read from `--with`."""

from __future__ import annotations

from collections.abc import Sequence

from elastic_arm.effects import EffectInstance, parse
from elastic_arm.effects.catalogue import find
from elastic_arm.errors import EffectError
from elastic_arm.robot import Robot


def known_effects(texts: Sequence[str], robot: Robot) -> tuple[EffectInstance, ...]:
    """Return the effects named as `EFFECT[:JOINT][:NAME=VALUE,…]`, on every joint where none is named.

    Numbers that are given are where the fit starts; what is not given starts from no effect.

    Raises
    ------
    EffectError
        If there is no such effect, joint or parameter.
    """
    return tuple(active for text in texts for active in _read(text, robot))


def _read(text: str, robot: Robot) -> list[EffectInstance]:
    head, _, values = text.partition("=")
    effect_id, _, rest = head.strip().partition(":")
    effect = find(effect_id)
    if values and all(p.name in text for p in effect.parameters if p.default is None):
        return [parse(text, robot)]
    joint = rest.split(":")[0] if rest and "=" not in rest and not (values and ":" not in rest) else None
    chosen = dict(item.split("=", 1) for item in text.split(":")[-1].split(",") if "=" in item)
    unknown = [name for name in chosen if name not in effect.names]
    if unknown:
        raise EffectError(f"{effect_id} has no parameter {unknown[0]!r}", f"Its parameters: {', '.join(effect.names)}")
    if joint is not None and joint not in robot.joint_names:
        raise EffectError(f"{effect_id}: there is no joint {joint!r}", f"Use one of {', '.join(robot.joint_names)}")
    defaults = {c.name: c.checked(chosen.get(c.name, c.default), effect_id) for c in effect.choices}
    places = [a for a in effect.candidates(robot) if all(a.parameters[k] == v for k, v in defaults.items())]
    named = [a for a in places if a.joint == joint]
    if joint is None and not named:
        named = places
    if not named:
        raise EffectError(f"{effect_id} cannot sit on {joint}", f"It sits on {effect.scope.value}")
    return named
