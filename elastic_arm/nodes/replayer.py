"""`ros2 run elastic_arm replayer`: plays a bag back onto its topics."""

import sys
import time
from collections.abc import Iterator
from typing import Any

from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from elastic_arm.errors import GraphError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.node import LONGEST_REST, ArmNode, Health
from elastic_arm.nodes.support.parameters import Setting, declared
from elastic_arm.nodes.support.running import run
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
PARAMETERS = {
    "bag": Setting("", "Bag to play: rosbag2 folder, .mcap or .db3 file"),
    "topics": Setting([], "Topics to play; empty: all supported topics"),
    "rate": Setting(1.0, "Speed relative to the recording", between=(0.01, 100.0), live=True),
    "loop": Setting(False, "Restart at the end", live=True),
    "clock": Setting(True, "Publish /clock"),
    "wait": Setting(True, "Wait for a subscriber"),
}


class Playback:
    """The messages of a bag, with a clock that may run faster or slower. `next` is the next
    message, None at the end."""

    def __init__(self, messages: Iterator[Message]) -> None:
        self._messages = messages
        self.next = next(messages, None)
        self._place_ns = 0.0 if self.next is None else float(self.next.log_ns)
        self._since: float | None = None

    def wait(self, now: float, rate: float) -> float:
        """Return the seconds until the next message is due, zero or less if it is."""
        assert self.next is not None, "there is no next message"
        if self._since is not None:
            self._place_ns += (now - self._since) * rate * NANOSECONDS
        self._since = now
        return (self.next.log_ns - self._place_ns) / NANOSECONDS / rate

    def take(self) -> Message:
        """Return the next message and advance."""
        assert self.next is not None, "there is no next message"
        taken = self.next
        self.next = next(self._messages, None)
        return taken


class Replayer(ArmNode):
    """Publishes the messages of a bag at the intervals of their recording."""

    def __init__(self) -> None:
        super().__init__("replayer")
        wanted = declared(self, PARAMETERS)
        self._bag = wanted.bag
        self._wait = wanted.wait
        self._rate = wanted.rate
        if not self._bag:
            raise GraphError("parameter bag is empty", "Give a bag: -p bag:=FOLDER.")
        self._outputs = self._make_publishers(set(wanted.topics))
        self._clock_output = self.output(topics.CLOCK, Clock) if wanted.clock else None
        self._clock_form = Form(topics.TYPES[topics.CLOCK], Clock())
        self._sent = self._rounds = 0
        self._begin()
        if self._playback.next is None:
            raise GraphError(
                f"{self._bag} contains no messages on {', '.join(self._outputs)}",
                "Choose other topics.",
            )
        self._begun = False
        self._matched: float | None = None
        self._finished = False
        Health(self, "bag", "playing", self._status)

    def tick(self) -> float:
        """Publish what is due."""
        if not self._begun:
            if not self._settled():
                return 0.02
            self._begun = True
        self._rate = self.get_parameter("rate").value
        for _ in range(BURST):
            if self._playback.next is None:
                self._end()
                return LONGEST_REST
            if (ahead := self._playback.wait(time.monotonic(), self._rate)) > 0:
                return ahead
            self._publish(self._playback.take())
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
            outputs[topic.name] = self.create_publisher(
                kind, self._placed(topic.name), graph.qos(topic.name)
            )
        if not outputs:
            held = ", ".join(topic.name for topic in found) or "no topics"
            raise GraphError(
                f"{self._bag} contains nothing to play; its topics are {held}",
                "Choose other topics.",
            )
        return outputs

    def _placed(self, topic: str) -> str:
        """Return the name under which a topic of the bag is published: in the namespace of this
        node, which its name may already contain."""
        namespace = self.get_namespace().rstrip("/")
        return topic if topic.startswith(f"{namespace}/") else namespace + topic

    def _begin(self) -> None:
        self._playback = Playback(read_messages(self._bag, set(self._outputs)))
        self._clock_ns = 0

    def _listened(self) -> bool:
        return not self._wait or any(
            output.get_subscription_count() for output in self._outputs.values()
        )

    def _settled(self) -> bool:
        """Return whether there is a subscriber, and other subscribers have had time to be
        discovered."""
        if not self._wait:
            return True
        if not self._listened():
            self._matched = None
            return False
        now = time.monotonic()
        self._matched = self._matched or now
        return now - self._matched >= SETTLING * graph.slowness()

    def _publish(self, message: Message) -> None:
        if self._clock_output is not None and message.log_ns >= self._clock_ns:
            self._clock_output.publish(self._clock_form.filled(message.log_ns))
            self._clock_ns = message.log_ns + CLOCK_PERIOD_NS
        self._outputs[message.topic].publish(message.data)
        self._sent += 1

    def _end(self) -> None:
        """Start again, or finish when the subscribers have received everything."""
        self._rounds += 1
        if self.get_parameter("loop").value:
            self._begin()
            return
        for output in self._outputs.values():
            output.wait_for_all_acked()
        self._finished = True
        self.get_logger().info(f"{self._sent} messages played from {self._bag}")

    def _status(self) -> tuple[list[str], dict[str, Any]]:
        problems = [] if self._listened() else ["no subscribers"]
        if problems and not self._begun:
            waiting = "waiting for one (with wait:=false, the bag is played at once)"
            problems = [f"no subscribers: {waiting}"]
        return problems, {"messages": self._sent, "rate": self._rate, "rounds": self._rounds}


if __name__ == "__main__":
    sys.exit(run(Replayer))
