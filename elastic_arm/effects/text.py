"""Effects written as text, `EFFECT[:JOINT][:NAME=VALUE,…]`: one grammar, read for three uses.

- :func:`parse`: an effect on an arm to be simulated; all that has no default is given.
- :func:`known_effects`: effects that a diagnosis counts as part of the model; what is not given is
  fitted.
- :func:`parse_laws`: effects identified beside the model's own parameters; linear parameters need
  no value.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from elastic_arm.effects.catalogue import Catalogue
from elastic_arm.effects.effect import Effect, EffectInstance, SensorEffect
from elastic_arm.effects.parameters import Choice, Role
from elastic_arm.errors import EffectError, ElasticArmError, IdentificationError
from elastic_arm.robot import Robot

_GRAMMAR = "Write EFFECT[:JOINT][:NAME=VALUE,NAME=VALUE]."


def read_effects(
    given: str | EffectInstance | Iterable[str | EffectInstance],
    read: Callable[[str], Iterable[EffectInstance]],
) -> tuple[EffectInstance, ...]:
    """Return effects, those that are text read by one of the functions below.

    Raises an EffectError if one is neither.
    """
    found: list[EffectInstance] = []
    for one in [given] if isinstance(given, str | EffectInstance) else given:
        if not isinstance(one, str | EffectInstance):
            raise EffectError(f"{one!r} is not an effect", _GRAMMAR)
        found += read(one) if isinstance(one, str) else [one]
    return tuple(found)


@dataclass(frozen=True)
class _ParsedInstance:
    """An effect as it was written: what is not there was not given."""

    effect: Effect
    joint: str | None
    values: dict[str, Any]

    def on(self, joint: str | None, **others: Any) -> EffectInstance:
        """Return the effect on a joint, with other values where none was written."""
        instance = EffectInstance(self.effect, joint, {**others, **self.values})
        _refuse_impossible(instance, self.values)
        return instance


def parse(
    text: str, robot: Robot | None = None, catalogue: Catalogue | None = None
) -> EffectInstance:
    """Read an effect on an arm.

    Such as `payload:mass=5,position=0/0/0.1` or `base_tilt:x=0.01,y=0`.

    Components of a vector are joined by `/`, several choices by `+`:
    `time_delay:channels=joint_torque+motor_torque`. The joint is checked where there is a robot.
    Raises an EffectError if it cannot be read, or no real arm has such an effect; the message lists
    what would be valid.
    """
    written = _read(text, catalogue)
    instance = written.on(written.joint)
    if robot is not None:
        instance.joint_indices(robot)
    return instance


def known_effects(
    texts: Sequence[str], robot: Robot, catalogue: Catalogue | None = None
) -> tuple[EffectInstance, ...]:
    """Return the effects that the user knows, on every joint where none is named."""
    found = []
    for text in texts:
        written = _read(text, catalogue)
        start = {p.name: p.start() for p in written.effect.parameters}
        for joint in _joints(written, robot):
            instance = written.on(joint, **start)
            instance.joint_indices(robot)
            found.append(instance)
    return tuple(found)


def parse_laws(
    texts: Sequence[str], robot: Robot, catalogue: Catalogue | None = None
) -> list[EffectInstance]:
    """Read effects whose linear parameters are to be identified.

    Without a joint they are on every joint.

    Raises an EffectError or IdentificationError if there is no such effect, none of its parameters
    is linear, or a value is given for one that is.
    """
    found = []
    for text in texts:
        written = _read(text, catalogue, "law", IdentificationError)
        effect = written.effect
        linear = [p for p in effect.parameters if p.role is Role.LINEAR]
        if not linear or effect.states or effect.scales_friction:
            raise IdentificationError(
                f"{effect.id} is not linear in its parameters",
                "Use `elastic-arm diagnose`, which searches them.",
            )
        if effect.in_time:
            raise IdentificationError(
                f"{effect.id} depends on the time since the start of the recording, which"
                " identification does not track",
                "Use `elastic-arm diagnose`.",
            )
        if isinstance(effect, SensorEffect) and any(p.neutral == 1.0 for p in linear):
            raise IdentificationError(
                f"{effect.id}: a torque gain and the masses cannot be identified together:"
                " zero masses explain every torque",
                "Omit it, or find it with `elastic-arm diagnose --refit`, which has priors"
                " for gains.",
            )
        if stated := [p.name for p in linear if p.name in written.values]:
            raise IdentificationError(
                f"{effect.id}: identification estimates {', '.join(stated)}, so it cannot be given",
                f"Omit it: {effect.id}{f':{written.joint}' if written.joint else ''}.",
            )
        neutral = {
            p.name: [p.neutral or 0.0] * p.size if p.size > 1 else p.neutral or 0.0 for p in linear
        }
        for joint in _joints(written, robot):
            instance = written.on(joint, **neutral)
            instance.joint_indices(robot)
            found.append(instance)
    return found


def _joints(written: _ParsedInstance, robot: Robot) -> Sequence[str | None]:
    """Return the joint that was named; without one, every joint, or the whole arm where all are
    alike."""
    if written.joint is not None:
        return [written.joint]
    places = written.effect.places(robot)
    return places[:1] if None in places else places


def _read(
    text: str,
    catalogue: Catalogue | None,
    what: str = "effect",
    kind: type[ElasticArmError] = EffectError,
) -> _ParsedInstance:
    """Take a text apart; an error of `kind` calls it `what`."""
    effect_id, *rest = text.strip().split(":")
    effect = (Catalogue.default() if catalogue is None else catalogue).find(effect_id.strip())
    joint = rest.pop(0).strip() if rest and "=" not in rest[0] else None
    if len(rest) > 1:
        raise kind(f"cannot read the {what} {text!r}", _GRAMMAR)
    values: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in (rest[0] if rest else "").split(","))):
        name, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not value:
            raise kind(
                f"cannot read {item!r} in the {what} {text!r}",
                "Write NAME=VALUE with NAME one of"
                f" {', '.join(effect.names) or '(it has no parameters)'}.",
            )
        values[name] = _value(effect, name, value)
    return _ParsedInstance(effect, joint or None, values)


def _value(effect: Effect, name: str, value: str) -> Any:
    choice = next((c for c in effect.choices if c.name == name), None)
    if isinstance(choice, Choice):
        return tuple(value.split("+")) if choice.several else value
    return tuple(value.split("/")) if "/" in value else value


def _refuse_impossible(instance: EffectInstance, written: dict[str, Any]) -> None:
    """Refuse what no real arm has, such as friction that drives. Arm files may hold it: a fit wrote
    it there."""
    for p in instance.effect.parameters:
        value: Any = instance.parameters[p.name]
        if p.name in written and min(value if isinstance(value, tuple) else (value,)) < p.least:
            unit = f" {p.unit}" if p.unit != "1" else ""
            raise EffectError(
                f"{instance.effect.id}: {p.name} is {value:g}{unit}",
                f"Give at least {p.least:g}{unit}.",
            )
