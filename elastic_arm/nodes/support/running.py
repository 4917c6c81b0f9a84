"""The life of a node's process: start, spin, stop; errors become one line and an exit code."""

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
)
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as rcl
from rclpy.signals import SignalHandlerOptions

from elastic_arm.errors import ElasticArmError
from elastic_arm.nodes.support.node import LONGEST_REST, ArmNode
from elastic_arm.nodes.transport import choose_transport

# A node that is stopped takes what has arrived: until nothing comes for `QUIET`, or this long where
# the stream goes on.
LONGEST_DRAIN = 1.0
QUIET = 0.02


def run(make: Callable[[], ArmNode], args: Sequence[str] | None = None) -> int:
    """Run a node until it is done, or SIGINT or SIGTERM stops it.

    make: makes the node; called after ROS is initialised.

    Returns the exit code: 0, or 2 after a mistake of the user's, which stands in one line on
    stderr.
    """
    words = sys.argv if args is None else args
    if unreadable := [word for word in words if not _is_text(word)]:
        # ROS takes UTF-8 alone, and says so in its own way.
        return _refuse(f"{unreadable[0]!r} is not valid UTF-8. Rename the file.")
    stop = _Stop()
    choose_transport(os.environ)
    try:
        rclpy.init(
            args=list(args) if args is not None else None,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except (rcl.RCLError, rcl.RCLInvalidROSArgsError, rcl.UnknownROSArgsError) as error:
        words = " ".join(str(error).split()).removesuffix(".")
        return _refuse(f"{words}. `config/` shows the parameters and their types.")
    try:
        _spin(make, stop)
    except ElasticArmError as error:
        return _refuse(str(error))
    except (
        ParameterException,
        InvalidParameterTypeException,
        InvalidParameterValueException,
    ) as error:
        return _refuse(
            f"{str(error).strip().removesuffix('.')}. `config/` shows the parameters and their"
            " types."
        )
    finally:
        rclpy.try_shutdown()
        # one that comes now is late, and would count as a crash
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    return 0


class _Stop:
    """Set by SIGINT and SIGTERM.

    A flag and not an exception, so that nothing is interrupted.
    """

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
    """Let the callbacks process the messages that had arrived when the node was stopped."""
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
