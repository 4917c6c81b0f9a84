"""Imperfections that every recording may have: zeros of torque channels, and a base that is not
level.

They are identified together with laws beyond the model. Without them, a constant torque would be
attributed to friction, masses and motor inertia. Imperfections that the recordings show to differ
from zero are free (Wald test by the scatter of their blocks); those that they show to be zero are
left out. The others are constrained to their ordinary size by a prior if the description also
serves as a prior, and otherwise left out: in a short recording, a zero and the moment of a mass
hardly differ, and leaving one out changes the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.effects import EFFECTS, Catalogue, EffectInstance, robot_effects
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.effects.text import parse_laws
from elastic_arm.estimation.effect_columns import torque_zeros
from elastic_arm.evidence.priors import OFFSET_SHARE, ZEROS
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.law_columns import place_of
from elastic_arm.identification.least_squares import Fit
from elastic_arm.recording import Samples
from elastic_arm.robot import Robot

# What differs from none by so many standard deviations is free: one in 15,000 would be called so by
# chance. Where a channel has one such zero, its others are from one standard deviation: from there
# on a parameter lowers the expected error of predictions.
CERTAIN = 4.0
LIKELY = 1.0
# What differs from none by so many at most, and is known to such a share of what is ordinary, is
# none; convention.
NONE = 2.0
KNOWN = 0.1
# Ordinary size of a zero as a share of its joint's largest torque: that of a diagnosis, at the mean
# of the scales that the zeros of an arm may have.
ZERO = OFFSET_SHARE * sum(scale * probability for scale, probability in ZEROS.items())
# Ordinary tilt of a base, rad: that of one which nobody has levelled; convention.
LEVEL = 0.02


@dataclass(frozen=True)
class NuisanceLaw:
    """A law that is identified without a request."""

    instance: EffectInstance  # The effect at its joint, as the description states it, if it does
    ordinary: float | None = (
        None  # Standard deviation of its prior, in the unit of its parameters; None where free
    )
    stated: bool = False  # Whether the description states it
    channel: str | None = None  # Of a zero

    @property
    def place(self) -> tuple[str, str | None]:
        """The effect's id and its joint."""
        return self.instance.effect.id, self.instance.joint


def nuisance_effects(robot: Robot, catalogue: Catalogue | None = None) -> dict[str, str | None]:
    """Return the effects that are identified without a request, each with the channel of its zero.

    None for an effect that is not a zero.
    """
    known = catalogue or EFFECTS
    found: dict[str, str | None] = {
        law: channel for channel, law in torque_zeros(known, robot).items()
    }
    return found | ({TILT: None} if TILT in known else {})


def possible_imperfections(
    recordings: Sequence[Samples],
    robot: Robot,
    asked: Sequence[EffectInstance],
    catalogue: Catalogue | None = None,
) -> tuple[NuisanceLaw, ...]:
    """Return zeros of all recorded torques and the tilt of the base, each with its ordinary size.

    Those that were requested are left out.
    """
    places = {(instance.effect.id, instance.joint) for instance in asked}
    stated = {(each.effect.id, each.joint): each for each in robot_effects(robot, catalogue)}
    found: list[NuisanceLaw] = []
    for law, channel in nuisance_effects(robot, catalogue).items():
        tilt: dict[str | None, float] = {None: LEVEL}
        sizes = tilt if channel is None else _ordinary_zeros(recordings, robot, channel)
        for at in parse_laws([law], robot, catalogue) if sizes else []:
            place = law, at.joint
            if place not in places and at.joint in sizes:
                known = stated.get(place, at)
                found.append(NuisanceLaw(known, sizes[at.joint], place in stated, channel))
    return tuple(found)


def _ordinary_zeros(
    recordings: Sequence[Samples], robot: Robot, channel: str
) -> dict[str | None, float]:
    """Return the ordinary size of the zero of a torque channel at each joint with that channel, and
    the torque in it."""
    have = [values for samples in recordings if (values := getattr(samples, channel)) is not None]
    if not have:
        return {}
    lacking = {
        robot.joint_names[j] for samples in recordings for c, j in samples.lacking if c == channel
    }
    sizes = ZERO * np.nanmax(np.abs(np.concatenate(have)), axis=0)
    named = zip(robot.joint_names, sizes.tolist(), strict=True)
    return {joint: size for joint, size in named if joint not in lacking and size > 0.0}


def told_apart(
    possible: Sequence[NuisanceLaw], equations: BaseRegression
) -> tuple[NuisanceLaw, ...]:
    """Return zeros, and of other laws those that no other parameter of the equations can replace.

    About a horizontal first axis, a tilt is equivalent to another centre of mass; for a sliding
    axis, to a zero.
    """
    return tuple(e for e in possible if e.stated or e.channel or _is_by_itself(e, equations))


def _is_by_itself(each: NuisanceLaw, equations: BaseRegression) -> bool:
    """Return whether the visible parameters of a law are separate base parameters, and there are
    any."""
    shares = [equations.base.T[:, equations.names.index(name)] for name in _names(each, equations)]
    traced = [share for share in shares if share.any()]
    alone = (np.count_nonzero(equations.base.T[np.argmax(np.abs(share))]) == 1 for share in traced)
    return bool(traced) and all(np.count_nonzero(share) == 1 for share in traced) and all(alone)


def judged_imperfections(
    possible: Sequence[NuisanceLaw], fit: Fit, equations: BaseRegression, *, held: bool
) -> tuple[NuisanceLaw, ...]:
    """Return which imperfections are identified, and how.

    Those that differ from zero are free; the others are constrained to their ordinary size or left
    out. Imperfections that the description states are never left out.
    """
    place = {name: k for k, name in enumerate(equations.base.names)}
    sizes = {}
    known = set()
    for each in possible:
        at = [place[name] for name in _names(each, equations) if name in place]
        sizes[each.place] = float(np.max(np.abs(fit.Psi[at]) / fit.std[at], initial=0.0))
        # What the recordings show to be none, more closely than is ordinary, needs no parameter.
        if (
            at
            and sizes[each.place] <= NONE
            and np.all(fit.std[at] < KNOWN * (each.ordinary or np.inf))
        ):
            known.add(each.place)
    shown = {law for (law, _), size in sizes.items() if size > CERTAIN}
    free = {
        each.place for each in possible if each.place[0] in shown and sizes[each.place] > LIKELY
    }
    kept = [
        each
        for each in possible
        if each.stated or each.place in free or (held and each.place not in known)
    ]
    return tuple(
        replace(each, ordinary=None) if each.place in free or not held else each for each in kept
    )


def _names(each: NuisanceLaw, equations: BaseRegression) -> list[str]:
    """Return the names of an imperfection's parameters in the equations."""
    place = place_of(each.instance, equations.model.robot)
    return [name for name in equations.names if name.rpartition(".")[0] == place]


def described_imperfections(found: Sequence[NuisanceLaw]) -> list[str]:
    """Return in words which imperfections were identified, and how."""
    shown = [each.place for each in found if each.ordinary is None and not each.stated]
    held = [each for each in found if each.ordinary is not None]
    notes = []
    usual = []
    if shown:
        free = ", ".join(f"{law}:{joint}" if joint else law for law, joint in shown)
        notes.append(f"also identified, as they differ from zero in the recordings: {free}")
    if any(each.channel for each in held):
        others = "the other " if shown else "the "
        usual.append(
            f"{others}zeros of torques ({ZERO:.0%} of the joint's largest torque; unconstrained in"
            " robot.yaml)"
        )
    if not all(each.channel for each in held):
        usual.append(f"the tilt of the base ({1e3 * LEVEL:g} mrad)")
    if usual:
        notes.append("also identified, constrained to their usual size: " + ", ".join(usual))
    return notes
