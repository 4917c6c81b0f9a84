"""The effects of this folder by id, and effects written as text or in an arm file."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from elastic_arm.effects import library
from elastic_arm.effects.model import Effect, EffectInstance
from elastic_arm.effects.parameters import Choice
from elastic_arm.errors import EffectError
from elastic_arm.robot import Robot


def discover() -> dict[str, Effect]:
    """Return the `EFFECT` of every module of the library that has one, by id."""
    found: dict[str, Effect] = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(library.__path__)):
        effect = getattr(importlib.import_module(f"{library.__name__}.{module}"), "EFFECT", None)
        if isinstance(effect, Effect):
            if effect.id in found:
                raise EffectError(f"two files of the catalogue hold {effect.id!r}", "Give each its own id.")
            found[effect.id] = effect
    return found


EFFECTS: Mapping[str, Effect] = MappingProxyType(discover())


def find(effect_id: str) -> Effect:
    """Return an effect by id; EffectError, with the ids that come close, where there is none."""
    if effect_id in EFFECTS:
        return EFFECTS[effect_id]
    close = difflib.get_close_matches(effect_id, EFFECTS, n=3, cutoff=0.5)
    hint = f"Did you mean {' or '.join(close)}? " if close else ""
    raise EffectError(f"there is no effect {effect_id!r}", f"{hint}The effects: {', '.join(EFFECTS)}.")


def parse(text: str, robot: Robot | None = None) -> EffectInstance:
    """Read an effect as `EFFECT[:JOINT][:NAME=VALUE,…]`.

    Examples: `coulomb_friction:joint_2:torque=13.9,side=link`, `base_tilt:x=0.01,y=0`,
    `payload:mass=5,position=0/0/0.1`, `time_delay:delay=0.003,channels=joint_torque+motor_torque`.

    Parameters
    ----------
    text
        The effect. Components of a vector are joined by `/`, several choices by `+`.
    robot
        When given, the joint is checked.

    Raises
    ------
    EffectError
        If it cannot be read, or no real arm has such an effect; the message lists what would be valid.
    """
    effect_id, *rest = text.strip().split(":")
    effect = find(effect_id.strip())
    joint = rest.pop(0).strip() if rest and "=" not in rest[0] else None
    if len(rest) > 1:
        raise EffectError(f"cannot read the effect {text!r}", "Write EFFECT[:JOINT][:NAME=VALUE,NAME=VALUE].")
    values: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in (rest[0] if rest else "").split(","))):
        name, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not value:
            raise EffectError(
                f"cannot read {item!r} in the effect {text!r}",
                f"Write NAME=VALUE with NAME one of {', '.join(effect.names) or '(it has no parameters)'}.",
            )
        values[name] = _value(effect, name, value)
    active = EffectInstance(effect, joint or None, values)
    _refuse_impossible(active)
    return _placed(active, robot)


def from_dict(entry: Mapping[str, Any], robot: Robot | None = None) -> EffectInstance:
    """Read an effect as an arm file holds it: `{"effect": id, "joint": name or None, "parameters": {…}}`."""
    extra = set(entry) - {"effect", "joint", "parameters"}
    if "effect" not in entry or extra:
        raise EffectError(f"cannot read the effect {dict(entry)!r}", "Give effect, joint and parameters, no more.")
    return _placed(EffectInstance(find(entry["effect"]), entry.get("joint"), entry.get("parameters") or {}), robot)


def robot_effects(robot: Robot) -> tuple[EffectInstance, ...]:
    """Return the effects that the robot's own description carries."""
    return tuple(from_dict(entry, robot) for entry in robot.effects)


def _refuse_impossible(active: EffectInstance) -> None:
    """Refuse what no real arm has, such as friction that drives. Arm files may hold it: a fit wrote it there."""
    for p in active.effect.parameters:
        value: Any = active.parameters[p.name]
        if min(value if isinstance(value, tuple) else (value,)) < p.least:
            unit = f" {p.unit}" if p.unit != "1" else ""
            raise EffectError(f"{active.effect.id}: {p.name} is {value:g}{unit}", f"Give {p.least:g}{unit} or more.")


def _placed(active: EffectInstance, robot: Robot | None) -> EffectInstance:
    if robot is not None:
        active.joint_indices(robot)
    return active


def _value(effect: Effect, name: str, value: str) -> Any:
    choice = next((c for c in effect.choices if c.name == name), None)
    if isinstance(choice, Choice):
        return tuple(value.split("+")) if choice.several else value
    return tuple(value.split("/")) if "/" in value else value
