"""`ros2 run elastic_arm replayer`: plays a bag back onto its topics."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import chain

from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from elastic_arm.errors import GraphError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.health import PERIOD, Health
from elastic_arm.nodes.support.parameters import declare, declare_texts
from elastic_arm.nodes.support.running import LONGEST_REST, ArmNode, run
from elastic_arm.nodes.support.wire import NANOSECONDS, Form
from elastic_arm.recording import topics
from elastic_arm.recording.storage.messages import Message, read_messages, read_topics

# Bag time between two messages on /clock.
CLOCK_PERIOD_NS = 10_000_000
# Messages sent at most before the executor gets its turn.
BURST = 50
# Listeners on other topics have this long, seconds, to be found after the first.
SETTLING = 0.5
# Its own status is the replayer's to publish, and so is the clock.
OWN = {topics.DIAGNOSTICS, topics.CLOCK}


class Replayer(ArmNode):
    """Publishes the messages of a bag in the rhythm of their recording."""

    def __init__(self) -> None:
        super().__init__("replayer")
        self._bag = declare(self, "bag", "", "Bag to play: rosbag2 folder, .mcap or .db3 file")
        wanted = declare_texts(self, "topics", "Topics to play; empty: all that are understood")
        self._rate = declare(self, "rate", 1.0, "Times the speed of the recording", between=(0.01, 100.0), live=True)
        self._loop = declare(self, "loop", False, "Begin again at the end", live=True)
        clock = declare(self, "clock", True, "Publish /clock")
        self._wait = declare(self, "wait", True, "Wait until somebody listens")
        if not self._bag:
            raise GraphError("parameter bag is empty", "Name a bag: -p bag:=FOLDER.")
        self._outputs = self._make_publishers(set(wanted))
        self._clock_output = self.create_publisher(Clock, topics.CLOCK, graph.qos(topics.CLOCK)) if clock else None
        self._clock_form = Form(topics.TYPES[topics.CLOCK], Clock())
        self._rewind()
        self._played_ns = 0.0
        self._sent = 0
        self._rounds = 0
        self._began: float | None = None
        self._matched: float | None = None
        self._finished = False
        self._health = Health(self, "bag")
        self.every(PERIOD, self._report)

    def tick(self) -> float:
        """Publish what is due."""
        if self._began is None and not self._settled():
            return 0.02
        self._rate = self.get_parameter("rate").value
        for _ in range(BURST):
            now = time.monotonic()
            if self._began is None:
                self._began = now
            if self._next is None:
                self._end()
                return LONGEST_REST
            due = self._played_ns + (now - self._began) * self._rate * NANOSECONDS
            ahead = self._next.log_ns - self._first_ns - due
            if ahead > 0:
                # From here on at the present rate, which may have changed.
                self._played_ns, self._began = due, now
                return ahead / NANOSECONDS / self._rate
            self._publish(self._next)
        return 0.0

    def done(self) -> bool:
        """Return whether the bag has been played."""
        return self._finished

    def _make_publishers(self, wanted: set[str]) -> dict[str, Publisher]:
        outputs = {}
        found = read_topics(self._bag)
        for topic in found:
            if topic.name in OWN or (wanted and topic.name not in wanted):
                continue
            try:
                kind = graph.message_class(topic.type_name)
            except GraphError as error:
                self.get_logger().warning(f"{topic.name} is not played: {error}")
                continue
            outputs[topic.name] = self.create_publisher(kind, self._placed(topic.name), graph.qos(topic.name))
        if not outputs:
            held = ", ".join(topic.name for topic in found) or "no topics"
            raise GraphError(f"{self._bag} has nothing to play; it holds {held}", "Choose other topics.")
        return outputs

    def _placed(self, topic: str) -> str:
        """Return where a topic of the bag is played: within this node's namespace, in which it may lie already."""
        namespace = self.get_namespace().rstrip("/")
        return topic if topic.startswith(f"{namespace}/") else namespace + topic

    def _rewind(self) -> None:
        messages: Iterator[Message] = read_messages(self._bag, set(self._outputs))
        self._next = next(messages, None)
        if self._next is None:
            raise GraphError(f"{self._bag} holds no messages on {', '.join(self._outputs)}", "Choose other topics.")
        self._messages = chain(messages, [None])
        self._first_ns = self._next.log_ns
        self._clock_ns = self._first_ns

    def _listened(self) -> bool:
        return not self._wait or any(output.get_subscription_count() for output in self._outputs.values())

    def _settled(self) -> bool:
        """Return whether somebody listens, and others have had the time to be found too."""
        if not self._wait:
            return True
        if not self._listened():
            self._matched = None
            return False
        now = time.monotonic()
        self._matched = self._matched or now
        return now - self._matched >= SETTLING

    def _publish(self, message: Message) -> None:
        if self._clock_output is not None and message.log_ns >= self._clock_ns:
            self._clock_output.publish(self._clock_form.filled(message.log_ns))
            self._clock_ns = message.log_ns + CLOCK_PERIOD_NS
        self._outputs[message.topic].publish(message.data)
        self._sent += 1
        self._next = next(self._messages)

    def _end(self) -> None:
        """Begin again, or have done once the peers have taken what they were sent."""
        self._rounds += 1
        if self.get_parameter("loop").value:
            self._rewind()
            self._began, self._played_ns = None, 0.0
            return
        for output in self._outputs.values():
            output.wait_for_all_acked()
        self._finished = True
        self.get_logger().info(f"{self._sent} messages played from {self._bag}")

    def _report(self) -> None:
        problems = [] if self._listened() else ["nobody listens"]
        if problems and self._began is None:
            problems = ["nobody listens: waiting for a subscriber (with wait:=false, the bag is played to nobody)"]
        self._health.report(problems, "playing", {"messages": self._sent, "rate": self._rate, "rounds": self._rounds})


def main() -> None:
    """Entry point."""
    sys.exit(run(Replayer))


if __name__ == "__main__":
    main()
