"""The console scripts of the nodes: `ros2 run elastic_arm simulator`, or `python -m` this module
and a name.

This module has no heavy imports: the libraries of a node take a second or two to load, and Ctrl-C
during that time should end the process as quietly as later.
"""

import os
import signal
import sys
from functools import partial
from importlib import import_module

from elastic_arm.errors import MissingExtraError, require_ros

CLASSES = {
    "simulator": "SimulatorNode",
    "trajectory_generator": "TrajectoryGenerator",
    "identifier": "IdentifierNode",
    "gap_monitor": "GapMonitorNode",
    "recorder": "Recorder",
    "replayer": "Replayer",
}


def _start(node: str) -> None:
    try:
        require_ros(f"{node} is a node, which needs")
    except MissingExtraError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    module = import_module(f"elastic_arm.nodes.{node}")
    sys.exit(module.run(getattr(module, CLASSES[node])))


simulator, trajectory_generator, identifier, gap_monitor, recorder, replayer = (
    partial(_start, name) for name in CLASSES
)

if __name__ == "__main__":
    _start(sys.argv.pop(1))
