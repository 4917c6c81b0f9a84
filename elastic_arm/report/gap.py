"""The report of a gap diagnosis: verdict first, then where, which, how far."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as MplFigure
from numpy.typing import NDArray
from scipy.signal import welch

from elastic_arm.effects import EFFECTS
from elastic_arm.gap.material import Material
from elastic_arm.gap.residuals import SIDES
from elastic_arm.gap.result import Cause, Diagnosis
from elastic_arm.gap.words import meaning
from elastic_arm.report.html import Block, Figure, Section, Table, Text, write_report
from elastic_arm.report.style import BLUE, GREY, ORANGE, VERMILION, draw_signal, new_figure, style

Array = NDArray[np.float64]

TONES = {"none": "good", "explained": "good", "unknown": "warn"}
SHOWN = 4  # causes that get figures of their own
EQUATION = {
    "link": "tau_J − [M q″ + S theta″ + c + c1 + g]",
    "drive": "tau_J − [K (theta − q) + D (theta′ − q′)]",
    "motor": "tau_m − [Sᵀ q″ + B theta″ + c2] − tau_J",
}


def write_gap_report(path: str | Path, found: Diagnosis) -> Path:
    """Write the report of a diagnosis as one HTML file."""
    subtitle = f"{found.robot} against {found.model}: {', '.join(found.identify) or 'a recording'}"
    return write_report(path, "Gap diagnosis", sections(found), subtitle=subtitle)


def sections(found: Diagnosis) -> list[Section]:
    """Return what the report says, most important first."""
    told = [Section("Verdict", _verdict(found)), Section("Where the gap lies", _where(found))]
    material = found.material
    if material is not None:
        told += [Section(_title(c), _cause(found, c, k, material)) for k, c in enumerate(found.causes[:SHOWN])]
    if found.causes:
        told.append(Section("How far it shrinks", [Figure(ladder(found), "Share of the excess that is left.")]))
    told.append(Section("Before and after", [_sizes(found)]))
    if material is not None:
        told.append(Section("What the residuals follow", [_regimes(found, material)]))
    told.append(Section("What this rests on", _grounds(found)))
    return told


def _title(cause: Cause) -> str:
    return f"{cause.effect.replace('_', ' ')}, {cause.joint or 'whole arm'}"


def _verdict(found: Diagnosis) -> list[Block]:
    blocks: list[Block] = [Text(f"{found.verdict}: {meaning(found)}", TONES[found.verdict])]
    if found.causes:
        named: list[list[object]] = [
            [
                c.effect,
                c.joint or "whole arm",
                ", ".join(c.sides),
                ", ".join(f"{n} = {_text(e.value)} ± {_text(e.std)} {e.unit}" for n, e in c.parameters.items()) or "–",
                f"{100 * c.shrink:.1f} %",
                f"{c.confidence:.2f}",
            ]
            for c in found.causes
        ]
        header = ["cause", "joint", "sides", "parameters", "shrinks the gap alone by", "confidence"]
        blocks.append(Table(header, named))
    others: list[list[object]] = [
        [
            f"{c.effect} on {c.joint or 'whole arm'}",
            f"{a.effect} on {a.joint or 'whole arm'}",
            a.confidence,
            a.separated_by,
        ]
        for c in found.causes
        for a in c.alternatives
    ]
    if others:
        blocks.append(Table(["instead of", "it may be", "probability", "told apart by"], others, "Alternatives", 2))
    if found.unexplained:
        rows = [[p.joint, p.side, p.regime.replace("_", " "), p.rmse] for p in found.unexplained]
        blocks.append(Table(["joint", "side", "follows", "rmse, Nm"], rows, "Not explained", 3))
    return blocks


def _where(found: Diagnosis) -> list[Block]:
    text = (
        "Each joint has three equations. Colours: residual on the validation data over its noise, "
        f"between 0 and {found.band:g} Hz. One is noise alone."
    )
    rows = [[side, EQUATION[side]] for side in SIDES]
    return [Text(text), Figure(gap_map(found)), Table(["side", "residual"], rows)]


def gap_map(found: Diagnosis) -> MplFigure:
    """Draw joints by sides, before and after."""
    with style():
        figure, axes = new_figure(1, 2, size=(8.6, 0.9 + 0.55 * len(found.joints)))
        for ax, size, title in zip(
            axes[0], (found.before, found.after), ("nominal model", "causes added"), strict=True
        ):
            ratio = np.array(
                [[_ratio(size.rmse.get((j, s)), found.noise.get((j, s))) for s in SIDES] for j in found.joints]
            )
            ax.imshow(np.log10(np.maximum(ratio, 1.0)), vmin=0.0, vmax=2.0, cmap="YlOrRd", aspect="auto")
            for (row, column), value in np.ndenumerate(ratio):
                place = (found.joints[row], SIDES[column])
                label = "–" if np.isnan(value) else f"{value:.1f}×\n{size.rmse[place]:.3g} Nm"
                colour = "white" if value > 30 else "black"
                ax.text(column, row, label, ha="center", va="center", fontsize=8, color=colour)
            ax.set_xticks(range(len(SIDES)), SIDES)
            ax.set_yticks(range(len(found.joints)), found.joints)
            ax.set_title(title, loc="left")
            ax.grid(False)
    return figure


def _cause(found: Diagnosis, cause: Cause, k: int, material: Material) -> list[Block]:
    effect = EFFECTS[cause.effect]
    row = _loudest(found, cause, material)
    side, joint = material.validate.layout.sides[row // len(found.joints)], found.joints[row % len(found.joints)]
    blocks: list[Block] = [Text(f"{effect.description} Law: {effect.formula}."), Text(f"Signature: {effect.signature}")]
    caption = f"{joint}, {side} side: residual of the nominal model, and what this cause alone makes of it."
    return [*blocks, Figure(portrait(material, k, row, len(found.joints)), caption)]


def portrait(material: Material, k: int, row: int, n: int) -> MplFigure:
    """Draw a residual against time, velocity, position and frequency, with a cause laid over."""
    part = max(range(len(material.before)), key=lambda i: len(material.before[i]))
    stretch = material.validate.parts[part].stretch
    before, left = material.before[part][:, row], material.alone[k][part][:, row]
    motion, i = stretch.motion, row % n
    linkwise = material.validate.layout.sides[row // n] == "link"
    w = np.interp(stretch.t, motion.t, (motion.dq if linkwise else motion.dtheta)[:, i])
    q = np.interp(stretch.t, motion.t, (motion.q if linkwise else motion.theta)[:, i])
    rate = material.validate.band.kept_rate
    with style():
        figure, axes = new_figure(2, 2, size=(9.4, 5.2))
        ax = axes[0, 0]
        draw_signal(ax, stretch.t, before, color=GREY, lw=2.2, alpha=0.6, label="residual")
        draw_signal(ax, stretch.t, before - left, color=VERMILION, lw=1.0, label="this cause")
        draw_signal(ax, stretch.t, left, color=BLUE, lw=0.8, label="left")
        ax.set_xlabel("time [s]")
        ax.legend()
        for ax, x, name in ((axes[0, 1], w, "velocity [rad/s]"), (axes[1, 0], q, "angle [rad]")):
            ax.plot(x[::2], before[::2], ".", color=GREY, ms=2.5, alpha=0.5, rasterized=True)
            ax.plot(x[::2], (before - left)[::2], ".", color=VERMILION, ms=1.5, alpha=0.6, rasterized=True)
            ax.set_xlabel(name)
        ax = axes[1, 1]
        for values, colour in ((before, GREY), (left, BLUE)):
            f, spectrum = welch(values, rate, nperseg=min(len(values), int(4 * rate)))
            ax.semilogy(f, np.sqrt(spectrum), color=colour)
        ax.set_xlabel("frequency [Hz]")
        ax.set_ylabel("Nm/√Hz")
        for ax in axes.flat[:3]:
            ax.set_ylabel("Nm")
    return figure


def ladder(found: Diagnosis) -> MplFigure:
    """Draw what is left of the gap with each cause alone and with all."""
    names = ["nominal model", *(_title(c) for c in found.causes), "all causes together"]
    left = [1.0, *(1.0 - c.shrink for c in found.causes), 1.0 - (found.shrink or 0.0)]
    with style():
        figure, axes = new_figure(size=(8.0, 0.9 + 0.36 * len(names)))
        ax = axes[0, 0]
        colours = [GREY, *[ORANGE] * len(found.causes), BLUE]
        ax.barh(range(len(names)), [max(100 * v, 0.0) for v in left], color=colours)
        for y, value in enumerate(left):
            ax.text(max(100 * value, 0.0) + 1, y, f"{100 * value:.1f} %", va="center", fontsize=8)
        if found.shrink_interval is not None:
            low, high = (100 * (1 - v) for v in reversed(found.shrink_interval))
            ax.plot([low, high], [len(names) - 1] * 2, color="black", lw=2)
        ax.set_yticks(range(len(names)), names)
        ax.set_xlim(0, 115)
        ax.invert_yaxis()
        ax.set_xlabel("excess left [%]")
    return figure


def _sizes(found: Diagnosis) -> Table:
    rows = [
        [j, s, found.noise[j, s], found.before.rmse[j, s], found.after.rmse[j, s], found.before.peak[j, s],
         found.after.peak[j, s]]
        for j in found.joints
        for s in SIDES
        if (j, s) in found.before.rmse
    ]  # fmt: skip
    header = ["joint", "side", "noise", "rmse before", "rmse after", "max before", "max after"]
    return Table(header, rows, f"Nm, validation data, 0 to {found.band:g} Hz", 3)


def _regimes(found: Diagnosis, material: Material) -> Table:
    places = [(s, j) for s in material.validate.layout.sides for j in found.joints]
    names = list(material.regimes[0])
    rows = [
        [j, s, *(f"{100 * shares[name]:.0f} %" if shares[name] > 0.02 else "" for name in names)]
        for (s, j), shares in zip(places, material.regimes, strict=True)
    ]
    header = ["joint", "side", *(name.replace("_", " ") for name in names)]
    return Table(header, rows, "Share of a residual's power that follows each; shares overlap.")


def _grounds(found: Diagnosis) -> list[Block]:
    blocks: list[Block] = [
        Text(f"Causes are fitted on {', '.join(found.identify) or 'the first two thirds'}; every figure of the gap is "
             f"measured on {', '.join(found.validate) or 'the last third'}, which no fit has seen."),
    ]  # fmt: skip
    blocks += [Text(note, "warn" if "not an independent" in note else "plain") for note in found.notes]
    return blocks


def _loudest(found: Diagnosis, cause: Cause, material: Material) -> int:
    """Return the row in which the cause takes off most."""
    k = found.causes.index(cause)
    saved = sum(
        ((b**2).sum(axis=0) - (a**2).sum(axis=0)) for b, a in zip(material.before, material.alone[k], strict=True)
    )
    return int(np.argmax(saved))


def _ratio(rmse: float | None, noise: float | None) -> float:
    return np.nan if rmse is None or not noise else rmse / noise


def _text(value: object) -> str:
    if value is None:
        return "?"
    if isinstance(value, list | tuple):
        return "(" + ", ".join(_text(v) for v in value) + ")"
    return f"{float(value):.4g}"  # type: ignore[arg-type]
