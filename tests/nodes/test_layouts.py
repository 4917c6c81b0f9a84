"""The layouts for Foxglove and PlotJuggler show topics and fields that the nodes publish."""

from __future__ import annotations

import importlib
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from elastic_arm.recording import topics

LAYOUTS = Path(__file__).parents[2] / "layouts"
RESIDUALS = re.compile(r"/gap_monitor/residuals/joint_\d/(link|drive|motor)$")


def fields_of(topic: str) -> set[str]:
    """Return the names of the fields of a topic's messages."""
    type_name = "elastic_arm_msgs/msg/GapResidual" if RESIDUALS.match(topic) else topics.TYPES[topic]
    package, _, name = type_name.split("/")
    return set(getattr(importlib.import_module(f"{package}.msg"), name).get_fields_and_field_types())


def test_foxglove_s_layout_names_what_is_there() -> None:
    """Every path of a plot is a topic and a field of its type, and every panel has its place."""
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())
    plots = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert len(plots) > 10
    for path in (*plots, layout["configById"]["RawMessages!gap"]["topicPath"]):
        topic, _, field = path.partition(".")
        assert field.split("[")[0] in fields_of(topic), path
    placed = re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"]))
    assert sorted(placed) == sorted(layout["configById"])


def test_plotjuggler_s_layout_names_what_is_there() -> None:
    """Every curve is a field of a joint's state, or of a residual."""
    curves = [str(curve.get("name")) for curve in ET.parse(LAYOUTS / "plotjuggler.xml").iter("curve")]
    assert len(curves) > 10
    for curve in curves:
        place, _, field = curve.rpartition("/")
        topic = place if RESIDUALS.match(place) else place.rpartition("/")[0]
        assert field in fields_of(topic), curve
