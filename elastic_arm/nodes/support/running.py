"""The life of a node's process: start, spin, stop; errors as one line and an exit code."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException, ParameterException
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer

from elastic_arm.errors import ElasticArmError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.transport import choose_transport

# How long a stop signal may wait for a node that has nothing to do.
LONGEST_REST = 0.1
# A node that is stopped takes what has arrived: until nothing comes for `QUIET`, or this long where the stream goes on.
LONGEST_DRAIN = 1.0
QUIET = 0.02


class ArmNode(Node):
    """A node with a rhythm of its own: the process calls :meth:`tick`, spins until the next is due, and so on.

    failure: set by a callback that met an error, which ends the node; an exception out of a callback would be
    logged by the executor with its traceback first.
    """

    failure: ElasticArmError | None = None

    def every(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Call something again and again, in real time: also where the node goes by a clock that nobody publishes."""
        return self.create_timer(seconds, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def output(self, topic: str, kind: Any) -> Publisher:
        """Return a publisher of one of the suite's topics."""
        return self.create_publisher(kind, graph.relative(topic), graph.qos(topic))

    def serve(self, kind: Any, name: str, answer: Callable[[Any], Mapping[str, Any] | None]) -> Service:
        """Offer a service: `answer` makes the fields of the response that are not its defaults."""

        def reply(request: Any, response: Any) -> Any:
            for field, value in (answer(request) or {}).items():
                setattr(response, field, value)
            return response

        return self.create_service(kind, f"~/{name}", reply)

    def serve_words(self, kind: Any, name: str, act: Callable[[Any], str]) -> Service:
        """Offer a service whose response states whether it succeeded, and in words what was done, or is wrong."""

        def answer(request: Any) -> Mapping[str, Any]:
            try:
                return {"message": act(request), "success": True}
            except ElasticArmError as error:
                return {"message": str(error), "success": False}

        return self.serve(kind, name, answer)

    def tick(self) -> float:
        """Do what is due; return the seconds until there is more to do."""
        return LONGEST_REST

    def done(self) -> bool:
        """Return whether the node has finished its work by itself."""
        return False

    def close(self) -> None:
        """Put in order what is to outlive the process; called once, whatever ended it."""


def run(make: Callable[[], ArmNode], args: Sequence[str] | None = None) -> int:
    """Run a node until it is done, or SIGINT or SIGTERM stops it.

    make: makes the node; called after ROS is initialised.

    Returns the exit code: 0, or 2 after a mistake of the user's, which stands in one line on stderr.
    """
    words = sys.argv if args is None else args
    if unreadable := [word for word in words if not _is_text(word)]:
        # ROS takes UTF-8 alone, and says so in its own way.
        return _refuse(f"{unreadable[0]!r} is no UTF-8 text. Rename the file.")
    stop = _Stop()
    choose_transport(os.environ)
    try:
        rclpy.init(args=list(args) if args is not None else None, signal_handler_options=SignalHandlerOptions.NO)
    except (rcl.RCLError, rcl.RCLInvalidROSArgsError, rcl.UnknownROSArgsError) as error:
        words = " ".join(str(error).split()).removesuffix(".")
        return _refuse(f"{words}. `config/` shows the parameters and their types.")
    try:
        _spin(make, stop)
    except ElasticArmError as error:
        return _refuse(str(error))
    except (ParameterException, InvalidParameterTypeException, InvalidParameterValueException) as error:
        return _refuse(f"{str(error).strip().removesuffix('.')}. `config/` shows the parameters and their types.")
    finally:
        rclpy.try_shutdown()
        for number in (signal.SIGINT, signal.SIGTERM):  # one that comes now is late, and would count as a crash
            signal.signal(number, signal.SIG_IGN)
    return 0


class _Stop:
    """Set by SIGINT and SIGTERM. A flag rather than an exception: nothing is cut off in the middle."""

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True


def _spin(make: Callable[[], ArmNode], stop: _Stop) -> None:
    node = make()
    # In this wheel the executor's own spin() burns a core; spin_once with a timeout does not.
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        while not (stop.asked or node.done()):
            executor.spin_once(timeout_sec=min(max(node.tick(), 0.0), LONGEST_REST))
            if node.failure is not None:
                raise node.failure
        _drain(executor)
    except ElasticArmError as error:
        node.failure = error  # for what its end writes and reports
        raise
    finally:
        executor.remove_node(node)
        try:
            node.close()
        finally:
            executor.shutdown()
            node.destroy_node()


def _drain(executor: Executor) -> None:
    """Let the callbacks have what had arrived when the node was stopped."""
    end = time.monotonic() + LONGEST_DRAIN
    while (began := time.monotonic()) < end:
        executor.spin_once(timeout_sec=QUIET)
        if time.monotonic() - began >= QUIET:
            return


def _is_text(word: str) -> bool:
    try:
        word.encode()
    except UnicodeEncodeError:
        return False
    return True


def _refuse(problem: str) -> int:
    print(f"error: {problem}", file=sys.stderr)
    return 2
