"""Residuals that no effect of the catalogue explains: nonparametric laws, and open residuals.

    left_r = sum of the power over the noise in the octaves of motion / number of values - 1

A residual r is open if left_r exceeds both the uncertainty of its sensors' noise and a tenth of its
own gap (:attr:`UnknownEffects.open_rows`): in the fitted recordings if the rest follows the motion,
or in the validation recordings if causes act there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array, Mask
from elastic_arm.diagnosis.decomposition import Decomposition, Unknown, without_parts
from elastic_arm.diagnosis.regimes import regime, shares
from elastic_arm.diagnosis.result import UnexplainedResidual
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.evidence.grams import OCTAVES, Bands
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.priors import LEFT, MOTION, NOISY


class KeptPower(NamedTuple):
    """The remaining power of a residual over its noise, in units of the noise power, and the limits
    from which it is open."""

    row: int
    fitted: float
    limit: float
    follows: bool  # whether it exceeds the limit in the fitted recordings and follows the motion
    judging: float
    limit_of_judging: float
    has_causes: bool  # whether causes act on it in the validation recordings

    @property
    def is_open(self) -> bool:
        """Whether it is unexplained."""
        return self.follows or (self.has_causes and self.judging > self.limit_of_judging)

    @property
    def words(self) -> str:
        """The remaining power, its recordings, and the limit, as a sentence."""
        if self.follows:
            return (
                f"the residual of the fitted recordings exceeds the noise power by"
                f" {self.fitted:.3g} times it, the limit is {self.limit:.3g}; it follows the motion"
            )
        return (
            f"the residual of the validation recordings exceeds the noise power by"
            f" {self.judging:.3g} times it, the limit where causes act is"
            f" {self.limit_of_judging:.3g}"
        )


@dataclass(frozen=True)
class UnknownEffects:
    """The residuals that the terms of the most probable set leave."""

    parts: Decomposition

    @cached_property
    def laws(self) -> list[tuple[float, Unknown]]:
        """The nonparametric laws that are more probable than not, with their probability."""
        found: dict[Key, tuple[float, Unknown]] = {}
        for p, fit in self.parts.explanation.sets:
            for t in fit.optional:
                if isinstance(t, Unknown):
                    before, first = found.get(t.key, (0.0, t))
                    found[t.key] = before + p, first
        # A place has one law, although it may be undecided which of several.
        at_place: dict[tuple[int, str], list[tuple[float, Unknown]]] = {}
        for p, t in found.values():
            at_place.setdefault(t.place, []).append((p, t))
        probable = []
        for each in at_place.values():
            if sum(p for p, _ in each) > 0.5:
                probable.append(max(each, key=lambda one: one[0]))
        return probable

    @property
    def open_rows(self) -> list[int]:
        """The residuals that keep more power than the noise of their sensors, and much of their own
        gap.

        Either in the fitted recordings, if the remainder follows the motion, or in the validation
        recordings, if causes act there and the remainder exceeds the noise of the fit.
        """
        return [one.row for one in self.kept if one.is_open]

    @cached_property
    def kept(self) -> list[KeptPower]:
        """The remaining power of each residual with the most probable set."""
        model = self.parts.fit.model
        data = self.parts.linear.data
        fitted = model.bands
        judging = Bands(data)
        none = [np.zeros_like(y) for y in self.parts.before]
        acting = without_parts(none, self.parts.causes_added)
        of_fitted = [fitted.n * fit.found.v for fit in (model.fit(()), self.parts.fit)]
        of_judging = []
        for residuals in (self.parts.before, self.parts.after, acting):
            white = data.whiten([r[:, :, None] for r in residuals])[:, 0]
            of_judging.append(judging.powers(white))
        found = []
        for row in range(judging.places):
            own = _slow(fitted, row)
            other = _slow(judging, row)
            n = float(fitted.n[own].sum())
            m = float(judging.n[other].sum())
            if not n or not m:
                continue
            # Mean powers in units of the sensors' noise: without terms, with the best set, and of
            # the causes.
            first, left = (float(power[own].sum()) / n - 1.0 for power in of_fitted)
            before, after, moved = (float(power[other].sum()) / m for power in of_judging)
            limit = max(NOISY, LEFT * first)
            follows = left > limit and _is_structured(fitted, self._white_left, own)
            # The noise of each recording is known only to a factor NOISY.
            noise = NOISY**2 * max(1.0, left + 1.0)
            limit_of_judging = max(noise, LEFT * (before - 1.0))
            found.append(
                KeptPower(row, left, limit, follows, after - 1.0, limit_of_judging, moved > NOISY)
            )
        return found

    @cached_property
    def _white_left(self) -> Array:
        """The whitened residuals (rows,) of the fitted recordings."""
        fit = self.parts.fit
        left = fit.model.y - fit.model.N @ (fit.numbers - fit.far_off)
        for t in fit.terms:
            sizes = [*np.ones(int(t.offset is not None)), *fit.raw(t)]
            left = left - np.hstack(t.parts) @ sizes
        return left

    @cached_property
    def rows(self) -> list[int]:
        """The residuals with an unknown effect: by nonparametric laws, then by remaining power."""
        names = self.parts.problem.robot.joint_names
        sides = self.parts.problem.layout.sides
        places = self.parts.places
        of_laws = []
        for _, term in self.laws:
            joint, side = term.place
            place = names[joint], side if side in sides else sides[0]
            of_laws.append(places.index(place))
        return [*dict.fromkeys([*of_laws, *self.open_rows])]

    @cached_property
    def share_left(self) -> dict[str | None, float]:
        """The remaining share of the gap at each joint with an unknown effect."""
        before, after = self.parts.gaps
        noise = before.of_sensors
        where = before.significant | after.significant
        first = before.place(where) / noise
        left = after.place(where) / noise
        places = self.parts.places
        joints = {places[row][0] for row in self.rows}
        found: dict[str | None, float] = {}
        for joint in joints:
            own = [row for row, place in enumerate(places) if place[0] == joint]
            whole = float(np.maximum(first[own], left[own]).sum())
            found[joint] = float(left[own].sum()) / whole if whole else 0.0
        return found

    @property
    def reasons(self) -> dict[Place, list[str]]:
        """Why each residual counts as unexplained, by joint and side."""
        places = self.parts.places
        found: dict[Place, list[str]] = {places[row]: [] for row in self.rows}
        names = self.parts.problem.robot.joint_names
        for probability, term in self.laws:
            words = f"a nonparametric law explains it, with a probability of {probability:.2f}"
            for (joint, _), own in found.items():
                if joint == names[term.place[0]]:
                    own.append(words)
        for one in self.kept:
            if one.is_open:
                found[places[one.row]].append(one.words)
        return found

    def residuals(self) -> list[UnexplainedResidual]:
        """Return the unexplained residuals with their sizes and regimes."""
        result = []
        for row in self.rows:
            joint, side = self.parts.places[row]
            rmse = float(self.parts.gaps[1].rmse[row])
            ratios = gear_ratios(self.parts, row)
            shown = shares(self.parts.linear.data, self.parts.after, row, ratios)
            result.append(UnexplainedResidual(joint, side, regime(shown), rmse))
        return result


def gear_ratios(parts: Decomposition, row: int) -> tuple[float, float]:
    """Return r_hd and r_tot of the joint to which a residual belongs."""
    robot = parts.problem.robot
    gear = robot.joints[row % robot.n].transmission
    return (gear.harmonic_drive_ratio, gear.r_tot) if gear else (1.0, 1.0)


def _slow(bands: Bands, row: int) -> Mask:
    """Return a mask of the bands of a residual at the frequencies of motion."""
    return (bands.place == row) & (OCTAVES[np.minimum(bands.octave, len(OCTAVES) - 1)] <= MOTION)


def _is_structured(bands: Bands, white: Array, among: Mask) -> bool:
    """Whether the whitened rows in some bands more probably follow a motion than are noise.

    The powers p of noise in the harmonics of an octave are exponential, p(p) = exp(-p/m)/m. A
    residual that follows a motion has much power in few harmonics, p(p) = s/(s + p)². m is the mean
    and s the median of the powers.
    """
    power = np.sum(white.reshape(-1, 2) ** 2, axis=1)
    of_pairs = bands.of_rows[::2]
    odds = 0.0
    for band in bands.used[among]:
        p = power[of_pairs == band] + 1e-12
        m = float(np.mean(p))
        s = float(np.median(p))
        odds += float(np.sum(np.log(s) - 2.0 * np.log(s + p) + np.log(m) + p / m))
    return odds > 0.0
