"""The layouts for Foxglove and PlotJuggler: as the programs read them, of what the nodes send."""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from elastic_arm_msgs.msg import GapResidual
from sensor_msgs.msg import JointState

from elastic_arm.nodes.support import graph
from elastic_arm.recording.topics import TYPES

LAYOUTS = Path(__file__).parents[2] / "layouts"
FOXGLOVE = json.loads((LAYOUTS / "foxglove.json").read_text())
PLOTJUGGLER = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
PANELS = FOXGLOVE["configById"]
PLOTS = {name: panel for name, panel in PANELS.items() if name.startswith("Plot!")}


def test_foxglove_s_layout_is_one() -> None:
    """What Lichtblick's `validateLayoutData` requires, and every panel has its place."""
    assert all(
        isinstance(FOXGLOVE[field], dict)
        for field in ("configById", "globalVariables", "userNodes", "layout")
    )
    assert isinstance(FOXGLOVE["playbackConfig"]["speed"], (int, float))
    placed = re.findall(r'"(\w+!\w+)"', json.dumps(FOXGLOVE["layout"]))
    assert sorted(placed) == sorted(PANELS)


def sent(topic: str) -> Any:
    """Return a message of an arm with three joints as its nodes send it on a topic."""
    message = graph.message_class(TYPES[topic])()
    if topic == "/gap":
        message.residuals = [GapResidual() for _ in range(9)]
    for name, kind in message.get_fields_and_field_types().items():
        if kind in ("sequence<double>", "sequence<string>"):
            setattr(
                message, name, [0.0] * 3 if "double" in kind else ["joint_1", "joint_2", "joint_3"]
            )
    return message


def element(message: Any, path: str) -> Any:
    """Return what a path such as `position[1]` names in a message."""
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", path):
        message = getattr(message, name)
        message = message[int(index)] if index else message
    return message


def curves(topic: str, message: Any) -> dict[str, Any]:
    """Return a message's numbers by the names that PlotJuggler's parser of ROS messages gives
    them."""
    if isinstance(message, JointState):
        channels = {kind: getattr(message, kind) for kind in ("position", "velocity", "effort")}
        return {
            f"{topic}/{name}/{k}": v[i]
            for k, v in channels.items()
            for i, name in enumerate(message.name)
        }
    return {
        f"{topic}/{name}": getattr(message, name) for name in message.get_fields_and_field_types()
    }


def test_what_the_layouts_show_is_sent() -> None:
    """Every path and every curve is a number of the messages of its topic, every other panel's
    topic is sent."""
    paths = [path["value"] for panel in PLOTS.values() for path in panel["paths"]]
    assert len(paths) > 10
    for path in paths:
        topic, _, field = path.partition(".")
        assert isinstance(element(sent(topic), field), float), path
    assert element(sent("/gap"), PANELS["RawMessages!gap"]["topicPath"].removeprefix("/gap.")) == []
    assert {
        *PANELS["3D!arm"]["topics"],
        PANELS["DiagnosticSummary!health"]["topicToRender"],
    } <= set(TYPES)
    drawn = [str(curve.get("name")) for curve in PLOTJUGGLER.iter("curve")]
    assert len(drawn) > 10
    for name in drawn:
        # Curves of joint states are named by joint and channel, those of other messages by field.
        topic = name.rsplit("/", 2 if "_states" in name else 1)[0]
        assert isinstance(curves(topic, sent(topic))[name], float), name
