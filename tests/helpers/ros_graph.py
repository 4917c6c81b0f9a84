"""A ROS graph of one's own for a test: nodes as processes, and a peer that listens to them."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from domain_coordinator import domain_id
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from elastic_arm.nodes.support import graph

# A guard against waiting for ever; a machine busy with other tests takes its time.
PATIENCE = 90.0


class NodeProcess:
    """A node of the suite in a process of its own."""

    def __init__(
        self,
        name: str,
        parameters: dict[str, Any],
        log: Path,
        env: dict[str, str],
        arguments: Sequence[str] = (),
    ) -> None:
        self.name, self.log = name, log
        # What comes later counts: parameters behind the files of parameters.
        options = [*arguments]
        options += [
            part for key, value in parameters.items() for part in ("-p", f"{key}:={_text(value)}")
        ]
        command = [sys.executable, "-m", f"elastic_arm.nodes.{name}", "--ros-args", *options]
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                command, stdout=output, stderr=subprocess.STDOUT, env=env
            )

    @property
    def output(self) -> str:
        """What it has written so far."""
        return self.log.read_text()

    def wait(self) -> int:
        """Return its exit code once it has ended by itself."""
        return self.process.wait(PATIENCE)

    def stop(self, number: int = signal.SIGINT) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.wait()


class Graph:
    """Nodes on a domain of their own, loopback only."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        self.env = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        self.env |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        self.nodes: list[NodeProcess] = []
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.peer: Node = rclpy.create_node("peer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.peer)
        self._clients: dict[str, Any] = {}

    def start(self, name: str, /, *arguments: str, **parameters: Any) -> NodeProcess:
        """Start a node with parameters, and further arguments of ROS such as `-r __ns:=/left`."""
        node = NodeProcess(
            name, parameters, self.folder / f"{len(self.nodes)}_{name}.log", self.env, arguments
        )
        self.nodes.append(node)
        return node

    def listen(self, kind: Any, topic: str) -> list[Any]:
        """Return a list that grows with the messages of a topic."""
        messages: list[Any] = []
        self.peer.create_subscription(kind, topic, messages.append, graph.qos(topic))
        return messages

    def status(self, node: str) -> dict[str, str]:
        """Return what a node reports of itself on /diagnostics, kept up to date: figures, and its
        words as `said`."""
        found: dict[str, str] = {}

        def note(message: DiagnosticArray) -> None:
            if node in message.status[0].name:
                found.update(
                    {v.key: v.value for v in message.status[0].values},
                    said=message.status[0].message,
                )

        self.peer.create_subscription(DiagnosticArray, "/diagnostics", note, 100)
        return found

    def until(self, condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> None:
        """Spin until a condition holds; fail when patience runs out, showing what the nodes
        said."""
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                said = "\n".join(f"--- {node.name}\n{node.output}" for node in self.nodes)
                raise AssertionError(f"not within {patience} s: {what}\n{said}")
            self._executor.spin_once(timeout_sec=0.1)

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service and return its response."""
        if service not in self._clients:
            self._clients[service] = self.peer.create_client(kind, service)
            self.until(self._clients[service].service_is_ready, f"{service} is offered")
            # The client knows the server then; the server may yet have to discover where its
            # answers are read.
            discovered = time.monotonic() + 0.5
            self.until(lambda: time.monotonic() > discovered, "half a second has passed")
        future = self._clients[service].call_async(request)
        self.until(future.done, f"{service} answers")
        return future.result()

    def close(self) -> None:
        """End whatever still runs."""
        for node in self.nodes:
            if node.process.poll() is None:
                node.process.kill()
            node.process.wait()
        self._executor.shutdown()
        self.peer.destroy_node()
        rclpy.shutdown(context=self._context)


@contextmanager
def ros_graph(folder: Path) -> Iterator[Graph]:
    """Give a graph on a domain that nobody else on this machine uses."""
    before = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    try:
        with domain_id() as domain:
            made = Graph(folder, domain)
            try:
                yield made
            finally:
                made.close()
    finally:
        if before is None:
            del os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]
        else:
            os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = before


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
