"""The layouts for Foxglove and PlotJuggler: as the programs read them, and a recording holds what they show."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from elastic_arm_msgs.msg import GapDiagnosis, ParameterEstimate
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from elastic_arm.excitation import FourierTrajectory
from elastic_arm.nodes.support import graph
from elastic_arm.recording.storage.messages import read_messages
from tests.helpers.ros_graph import ros_graph

LAYOUTS = Path(__file__).parents[2] / "layouts"
FOXGLOVE = json.loads((LAYOUTS / "foxglove.json").read_text())
PLOTJUGGLER = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
PANELS = FOXGLOVE["configById"]
PLOTS = {name: panel for name, panel in PANELS.items() if name.startswith("Plot!")}


def test_foxglove_s_layout_is_one() -> None:
    """What Lichtblick's `validateLayoutData` requires, and every panel has its place."""
    assert all(isinstance(FOXGLOVE[field], dict) for field in ("configById", "globalVariables", "userNodes", "layout"))
    assert isinstance(FOXGLOVE["playbackConfig"]["speed"], (int, float))
    placed = re.findall(r'"(\w+!\w+)"', json.dumps(FOXGLOVE["layout"]))
    assert sorted(placed) == sorted(PANELS)


def test_foxglove_s_plots_have_their_types_fields() -> None:
    """Fields and values are those of Lichtblick's `PlotConfig` and `PlotPath`; those without `?` are there."""
    needed = {"paths", "showLegend", "legendDisplay", "showPlotValuesInLegend", "showXAxisLabels", "showYAxisLabels"}
    needed |= {"isSynced", "xAxisVal", "sidebarDimension"}
    titles = {"foxglovePanelTitle", "lichtblickPanelTitle"}
    for panel in PLOTS.values():
        assert needed | titles <= set(panel) <= needed | titles | {"followingViewWidth"}
        assert (panel["legendDisplay"], panel["xAxisVal"]) == ("floating", "timestamp")
        for path in panel["paths"]:
            assert set(path) == {"value", "enabled", "timestampMethod", "label"}
            assert path["timestampMethod"] in ("headerStamp", "receiveTime")


def test_plotjuggler_s_layout_is_one() -> None:
    """Elements and attributes are those that its `xmlLoadState` looks for, as many as it counts."""
    assert PLOTJUGGLER.tag == "root"
    (window,) = PLOTJUGGLER.findall("tabbed_widget")
    assert window.attrib == {"name": "Main Window", "parent": "main_window"}
    tabs = window.findall("Tab")
    index = window.find("currentTabIndex")
    assert index is not None and 0 <= int(index.get("index", "")) < len(tabs)
    for tab in tabs:
        assert tab.get("tab_name")
        (container,) = tab
        (splitter,) = container
        areas = splitter.findall("DockArea")
        assert len(areas) == len(splitter) == int(splitter.get("count", ""))
        assert splitter.get("orientation") in ("|", "-")
        assert sum(map(float, splitter.get("sizes", "").split(";"))) == pytest.approx(1.0, abs=1e-3)
        for area in areas:
            (plot,) = area
            assert (plot.tag, plot.get("mode")) == ("plot", "TimeSeries")
            assert {child.tag for child in plot} == {"limitY", "curve"}
            assert all(re.fullmatch("#[0-9a-f]{6}", curve.get("color", "")) for curve in plot.iter("curve"))


def record(folder: Path) -> Path:
    """Record every topic of an arm with friction until it was identified and diagnosed; return the bag."""
    rng = np.random.default_rng(5)
    a, b = (rng.normal(0.0, 0.3, (3, 5)) for _ in range(2))
    joints = ("joint_1", "joint_2", "joint_3")
    FourierTrajectory(2 * np.pi / 20.0, a, b, np.zeros(3), 20.0, 0.5, joints).save(folder / "trajectory.yaml")
    with ros_graph(folder) as made:
        found, estimates = made.listen(GapDiagnosis, "/gap"), made.listen(ParameterEstimate, "/parameter_estimate")
        made.start("gap_monitor", window=8.0, period=5.0)
        made.start("identifier")
        recorder = made.start("recorder", bag=folder / "bag", all=True)
        made.start("simulator", effects="['coulomb_friction:joint_2:torque=6.0']", real_time_factor=0.8)
        made.start("trajectory_generator", trajectory=folder / "trajectory.yaml", repeat=0, use_sim_time=True)
        made.until(lambda: found and estimates, "the arm is diagnosed and identified", patience=180)
        assert recorder.stop() == 0, recorder.output
    return folder / "bag"


def element(message: Any, path: str) -> Any:
    """Return what a path such as `position[1]` names in a message."""
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", path):
        message = getattr(message, name)
        message = message[int(index)] if index else message
    return message


def curves(topic: str, message: Any) -> dict[str, Any]:
    """Return a message's numbers by the names that PlotJuggler's parser of ROS messages gives them."""
    if isinstance(message, JointState):
        channels = {kind: getattr(message, kind) for kind in ("position", "velocity", "effort")}
        return {f"{topic}/{name}/{k}": v[i] for k, v in channels.items() for i, name in enumerate(message.name)}
    return {f"{topic}/{name}": getattr(message, name) for name in message.get_fields_and_field_types()}


@pytest.mark.graph
@pytest.mark.slow(30)
def test_a_recording_holds_all_that_the_layouts_show(tmp_path: Path) -> None:
    """Every path is a number of the recording's last message of its topic, every other panel's topic is recorded."""
    last = {message.topic: message for message in read_messages(record(tmp_path))}
    messages = {
        topic: deserialize_message(message.data, graph.message_class(message.type_name))
        for topic, message in last.items()
    }
    paths = [path["value"] for panel in PLOTS.values() for path in panel["paths"]]
    assert len(paths) > 10
    for path in paths:
        topic, _, field = path.partition(".")
        assert isinstance(element(messages[topic], field), float), path
    assert len(element(messages["/gap"], PANELS["RawMessages!gap"]["topicPath"].removeprefix("/gap."))) > 0
    shown = {*PANELS["3D!arm"]["topics"], PANELS["DiagnosticSummary!health"]["topicToRender"]}
    assert shown <= set(messages)

    known = {name: value for topic, message in messages.items() for name, value in curves(topic, message).items()}
    drawn = [str(curve.get("name")) for curve in PLOTJUGGLER.iter("curve")]
    assert len(drawn) > 10
    for name in drawn:
        assert isinstance(known[name], float), name
