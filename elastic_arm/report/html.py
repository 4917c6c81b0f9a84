"""Self-contained HTML reports: sections of text, tables and figures in one file that needs no
network."""

import datetime
import io
import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as MplFigure

from elastic_arm.arrays import Array
from elastic_arm.output_files import write_result
from elastic_arm.report.legend import meaning
from elastic_arm.report.style import POINTS, envelope_indices, style
from elastic_arm.version import __version__

_counter = itertools.count()
# Text of up to so many characters is never broken into lines; numbers below are written without a
# power of ten.
SHORT = 16
LARGEST_PLAIN = 1e7


@dataclass(frozen=True)
class Text:
    """A paragraph; `tone` is "plain", "good", "warn" or "bad"."""

    text: str
    tone: str = "plain"


class Written(str):
    """A number as text, where its digits depend on more than itself.

    It is placed as numbers are.
    """


@dataclass(frozen=True)
class Table:
    """A table.

    Numbers are right-aligned with `digits` significant digits, one count or one a column.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    digits: int | Sequence[int] = 4

    def heads(self) -> list[tuple[str, str]]:
        """Return each heading as (text, CSS class), aligned as its column."""
        numeric = self._numeric()
        return [(text, "number" if numeric[k] else "") for k, text in enumerate(self.header)]

    def legend(self) -> list[tuple[str, str]]:
        """Return headings with what they mean."""
        return [(text, words) for text in self.header if (words := meaning(text))]

    def cells(self) -> list[list[tuple[str, str]]]:
        """Return each cell as (text, CSS class)."""
        numeric = self._numeric()
        digits = self.digits
        if isinstance(digits, int):
            digits = [digits] * len(self.header)
        found = []
        for row in self.rows:
            texts = [written(value, d) for value, d in zip(row, digits, strict=True)]
            classes = map(_class, texts, row, numeric)
            found.append(list(zip(texts, classes, strict=True)))
        return found

    def _numeric(self) -> list[bool]:
        return [any(_is_number(row[k]) for row in self.rows) for k in range(len(self.header))]


def written(value: Any, digits: int) -> str:
    """Return a table's value as text: numbers with `digits` significant digits.

    Thousands apart, no needless powers.
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    if isinstance(value, float):
        text = f"{value:.{digits}g}"
        return f"{float(text):.0f}" if "e+" in text and abs(value) < LARGEST_PLAIN else text
    return str(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | Written) and not isinstance(value, bool)


def _class(text: str, value: Any, numeric: bool) -> str:
    if _is_number(value) or (value is None and numeric):
        return "number"
    return "short" if len(text) <= SHORT else ""


@dataclass(frozen=True)
class Figure:
    """A drawing with what it shows in a sentence."""

    figure: MplFigure
    caption: str = ""

    def svg(self) -> str:
        """Return the drawing as inline SVG whose ids collide with no other figure's."""
        buffer = io.StringIO()
        with style(), mpl.rc_context({"svg.hashsalt": f"figure{next(_counter)}"}):
            self.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        svg = buffer.getvalue()
        svg = svg[svg.index("<svg") :]
        return re.sub(r'<svg ([^>]*?)width="[^"]*pt" height="[^"]*pt"', r"<svg \1", svg, count=1)

    @property
    def width(self) -> int:
        """Width on screen, CSS pixels."""
        return round(self.figure.get_figwidth() * 110)


@dataclass(frozen=True)
class Plot:
    """Signals (N,) over time, each with its colour.

    A reader zooms by dragging and reads values by pointing.
    """

    t: Array
    signals: Mapping[str, tuple[Array, str]]
    unit: str
    caption: str = ""

    def data(self) -> str:
        """Return what uPlot draws, as JSON: signals thinned so that every extreme stays."""
        values = [values for values, _ in self.signals.values()]
        keep = np.unique(np.concatenate([envelope_indices(one, POINTS) for one in values]))
        columns = [[float(f"{v:.5g}") for v in one[keep]] for one in (self.t, *values)]
        series = [{"label": name, "stroke": colour} for name, (_, colour) in self.signals.items()]
        return json.dumps({"data": columns, "series": series, "unit": self.unit})


Block = Text | Table | Figure | Plot


@dataclass(frozen=True)
class Section:
    """A heading and its content.

    Details are folded until the heading is clicked, or the page printed.
    """

    title: str
    blocks: Sequence[Block] = field(default_factory=tuple)
    folded: bool = False


def write_report(
    path: str | Path, title: str, sections: Sequence[Section], *, subtitle: str = ""
) -> Path:
    """Write one HTML file.

    Raises an OutputError when the file cannot be written.
    """
    template = _templates().get_template("report.html")
    page = template.render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        plots=any(isinstance(block, Plot) for section in sections for block in section.blocks),
        made=datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M"),
        version=__version__,
    )
    return write_result(path, page, remedy="Choose another folder with --out.")


def fragment(blocks: Sequence[Block]) -> str:
    """Return blocks as HTML to be shown within a page, as that of a notebook."""
    return _templates().get_template("blocks.html").render(blocks=blocks)


def _templates() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("elastic_arm.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.tests["text"] = lambda block: isinstance(block, Text)
    environment.tests["plot"] = lambda block: isinstance(block, Plot)
    environment.tests["table"] = lambda block: isinstance(block, Table)
    return environment
