"""Reports: one file, complete, opened by a real browser."""

import re

import numpy as np
import pytest

from elastic_arm.report.html import Figure, Section, Table, Text, write_report
from elastic_arm.report.style import draw_signal, drawing, envelope_indices
from tests.helpers.browser import rendered_page


def _figure():
    with drawing() as (figure, axes):
        t = np.linspace(0.0, 10.0, 20_000)
        draw_signal(axes[0, 0], t, np.sin(t))
    return Figure(figure, "A sine.")


@pytest.mark.browser
def test_report_shows_its_text_tables_and_figures_in_a_browser(tmp_path):
    """A report written to one file shows every block in a real browser."""
    sections = [
        Section("Verdict", [Text("Nothing is <wrong>.", "good")]),
        Section("Numbers", [Table(["joint", "rmse"], [["joint_1", 0.25], ["joint_2", None]])]),
        Section("Pictures", [_figure(), _figure()]),
    ]
    page = rendered_page(
        write_report(tmp_path / "sub" / "report.html", "A report", sections), tmp_path / "profile"
    )
    assert "Nothing is &lt;wrong&gt;." in page
    assert page.count("<svg") == 2
    assert ">0.25<" in page and ">–<" in page


def test_report_needs_no_network(tmp_path):
    """A report refers to nothing outside itself."""
    page = write_report(
        tmp_path / "report.html", "A report", [Section("Pictures", [_figure()])]
    ).read_text()
    references = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert all(reference.startswith("#") for reference in references)


def test_ids_of_two_equal_figures_differ(tmp_path):
    """Two drawings in one page do not share clip paths or markers."""
    page = write_report(
        tmp_path / "report.html", "A report", [Section("P", [_figure(), _figure()])]
    ).read_text()
    clips = re.findall(r'<clipPath id="([^"]*)"', page)
    assert clips and len(clips) == len(set(clips))


@pytest.mark.parametrize(("count", "peak"), [(14_661, 14_600), (1_000_003, 1_000_001)])
def test_thinning_keeps_extremes_near_the_end(count, peak):
    """Where bins do not divide the samples evenly, the last ones are drawn as densely as the
    others."""
    y = np.zeros(count)
    y[peak] = 1.0
    keep = envelope_indices(y, 1500)
    assert peak in keep
    assert np.diff(keep).max() <= 2 * -(-count // 750)
    assert len(keep) <= 1502


def test_tables_write_numbers_for_reading():
    """No powers of ten where a plain number will do; own digits a column; a missing number stands
    where numbers do."""
    table = Table(
        ["name", "value", "std"],
        [["K", 150_000.0, 1.2345], ["a long name that breaks", 3.2e-7, None]],
        digits=(1, 3, 2),
    )
    assert table.heads() == [("name", ""), ("value", "number"), ("std", "number")]
    assert table.cells() == [
        [("K", "short"), ("150000", "number"), ("1.2", "number")],
        [("a long name that breaks", ""), ("3.2e-07", "number"), ("–", "number")],
    ]


def test_thinning_keeps_the_extremes():
    """However long a signal is, its largest and smallest sample are drawn."""
    y = np.random.default_rng(0).normal(size=100_000)
    keep = envelope_indices(y, 500)
    assert len(keep) <= 504
    assert y[keep].max() == y.max() and y[keep].min() == y.min()
