"""The console scripts of the nodes: `ros2 run elastic_arm simulator`, or `python -m` this module and a name.

A module apart, without imports of weight: a node's own libraries take a second or two to load, and a Ctrl-C in that
time should end the process as quietly as one later on.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys

from elastic_arm.errors import MissingExtraError, require_ros


def _start(node: str) -> None:
    try:
        require_ros(f"{node} is a node, which needs")
    except MissingExtraError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    importlib.import_module(f"elastic_arm.nodes.{node}").main()


def simulator() -> None:
    """Start the simulator."""
    _start("simulator")


def trajectory_generator() -> None:
    """Start the trajectory generator."""
    _start("trajectory_generator")


def identifier() -> None:
    """Start the identifier."""
    _start("identifier")


def gap_monitor() -> None:
    """Start the gap monitor."""
    _start("gap_monitor")


def recorder() -> None:
    """Start the recorder."""
    _start("recorder")


def replayer() -> None:
    """Start the replayer."""
    _start("replayer")


if __name__ == "__main__":
    _start(sys.argv.pop(1))
