"""Nodes as child processes: start them together, watch them, stop them as Ctrl-C would."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from elastic_arm.errors import GraphError, require_ros

# How long a node may take to put things in order after it was asked to stop, seconds; and where the user does not wait
# for what it leaves behind.
PATIENCE = 30.0
ABANDONED = 5.0


class Nodes:
    """A set of the suite's nodes, each a process of its own; leaving the context stops them all.

    folder: where parameter files and logs of the nodes go; domain: ROS_DOMAIN_ID, so that the nodes meet nobody
    else.
    """

    def __init__(self, folder: Path, domain: int) -> None:
        require_ros("this command starts nodes, which need")
        self._folder = folder
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        self._environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self._running: dict[str, subprocess.Popen[str]] = {}
        self.lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def __enter__(self) -> Nodes:
        self._folder.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # A Ctrl-C that is raised again must not leave nodes behind, which the terminal does not reach.
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for process in self._running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        end = time.monotonic() + ABANDONED
        for name in list(self._running):
            self._end(name, max(end - time.monotonic(), 0.1) if kind is not None else PATIENCE)

    def start(self, name: str, parameters: Mapping[str, Any]) -> None:
        """Start node `name` with `parameters`; what it prints on stdout arrives in `lines`."""
        file = self._folder / f"{name}.yaml"
        file.write_text(yaml.safe_dump({name: {"ros__parameters": dict(parameters)}}), encoding="utf-8")
        command = [sys.executable, "-m", f"elastic_arm.nodes.{name}", "--ros-args", "--params-file", str(file)]
        with self.log(name).open("w", encoding="utf-8") as log:
            process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=log, text=True, env=self._environment, start_new_session=True
            )
        self._running[name] = process
        threading.Thread(target=self._listen, args=(process,), daemon=True).start()

    def log(self, name: str) -> Path:
        """Return the file of a node's stderr."""
        return self._folder / f"{name}.log"

    def running(self, name: str) -> bool:
        """Return whether a node still runs.

        Raises a GraphError if any of the nodes died of an error.
        """
        for other, process in self._running.items():
            if process.poll() not in (None, 0):
                raise GraphError(f"node {other} ended with code {process.returncode}: {self._last_words(other)}")
        return self._running[name].poll() is None

    def stop(self, name: str) -> None:
        """Interrupt a node, and wait until it has ended.

        Raises a GraphError if it does not, or ends with an error.
        """
        code = self._end(name)
        if code != 0:
            raise GraphError(f"node {name} ended with code {code}: {self._last_words(name)}")

    def told(self, seconds: float) -> Iterator[str]:
        """Yield the lines that arrive within `seconds`."""
        try:
            yield self.lines.get(timeout=seconds)
            while True:
                yield self.lines.get_nowait()
        except queue.Empty:
            return

    def _end(self, name: str, patience: float = PATIENCE) -> int:
        process = self._running.pop(name)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            return process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def _listen(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self.lines.put(line)

    def _last_words(self, name: str) -> str:
        words = self.log(name).read_text(encoding="utf-8").strip().splitlines()
        return f"{words[-1].removeprefix('error: ')} (all of it in {self.log(name)})" if words else "it said nothing"
