"""`ros2 run elastic_arm replayer`: plays a bag back onto its topics."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rosbag2_interfaces.srv import Burst, GetRate, IsPaused, Pause, PlayNext, Resume, Seek, SetRate, TogglePaused
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
    "topics": Setting([], "Topics to play; empty: all that are understood"),
    "rate": Setting(1.0, "Times the speed of the recording", between=(0.01, 100.0), live=True),
    "loop": Setting(False, "Begin again at the end", live=True),
    "clock": Setting(True, "Publish /clock"),
    "wait": Setting(True, "Wait until somebody listens"),
    "start_offset": Setting(0.0, "Seconds of the bag to leave out at its start", between=(0.0, 1e6)),
    "start_paused": Setting(False, "Begin with the clock standing still"),
}


class Playback:
    """The messages of a bag on a clock that may stand still, run faster and be set.

    read: returns the messages in the order they were logged, from the first on. `next` is the message that comes next,
    None at the end; `first_ns` when the first was logged, None of a bag without messages.
    """

    def __init__(self, read: Callable[[], Iterator[Message]]) -> None:
        self._read = read
        self.paused = False
        self._messages = read()
        self.next = next(self._messages, None)
        self.first_ns = None if self.next is None else self.next.log_ns
        self._place_ns = float(self.first_ns or 0)
        self._since: float | None = None

    def seek(self, to_ns: int) -> list[Message]:
        """Set the clock: the next message is the first logged at `to_ns` or later; return those passed over."""
        self._messages = self._read()
        self._since = None
        self._place_ns = float(max(to_ns, self.first_ns or 0))
        passed = []
        self.next = next(self._messages, None)
        while self.next is not None and self.next.log_ns < to_ns:
            passed.append(self.next)
            self.next = next(self._messages, None)
        return passed

    def wait(self, now: float, rate: float) -> float:
        """Return the seconds until the next message is due, zero or less when it is."""
        assert self.next is not None, "there is no next message"
        if self._since is not None and not self.paused:
            self._place_ns += (now - self._since) * rate * NANOSECONDS
        self._since = now
        return (self.next.log_ns - self._place_ns) / NANOSECONDS / rate

    def take(self) -> Message:
        """Return the next message and go on to the one behind it; a clock that stands still is set to it."""
        assert self.next is not None, "there is no next message"
        taken, self.next = self.next, next(self._messages, None)
        if self.paused:
            self._place_ns = max(self._place_ns, float(taken.log_ns))
        return taken


class Replayer(ArmNode):
    """Publishes the messages of a bag in the rhythm of their recording; its services are those of rosbag2's player."""

    def __init__(self) -> None:
        super().__init__("replayer")
        wanted = declared(self, PARAMETERS)
        self._bag, self._wait, self._rate = wanted.bag, wanted.wait, wanted.rate
        if not self._bag:
            raise GraphError("parameter bag is empty", "Name a bag: -p bag:=FOLDER.")
        self._outputs = self._make_publishers(set(wanted.topics))
        self._clock_output = self.output(topics.CLOCK, Clock) if wanted.clock else None
        self._clock_form = Form(topics.TYPES[topics.CLOCK], Clock())
        self._playback = Playback(lambda: read_messages(self._bag, set(self._outputs)))
        if self._playback.first_ns is None:
            raise GraphError(f"{self._bag} holds no messages on {', '.join(self._outputs)}", "Choose other topics.")
        self._begin_ns = self._playback.first_ns + round(wanted.start_offset * NANOSECONDS)
        self._sent = self._rounds = 0
        self._clock_ns = 0
        if not self._seek(self._begin_ns):
            raise GraphError(f"{self._bag} ends before {wanted.start_offset:g} s", "Choose a smaller start_offset.")
        self._playback.paused = wanted.start_paused
        self._begun = False
        self._matched: float | None = None
        self._finished = False
        self._offer_services()
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
                if not self._playback.paused:
                    self._end()
                return LONGEST_REST
            ahead = self._playback.wait(time.monotonic(), self._rate)
            if self._playback.paused:
                return LONGEST_REST
            if ahead > 0:
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
            outputs[topic.name] = self.create_publisher(kind, self._placed(topic.name), graph.qos(topic.name))
        if not outputs:
            held = ", ".join(topic.name for topic in found) or "no topics"
            raise GraphError(f"{self._bag} has nothing to play; it holds {held}", "Choose other topics.")
        return outputs

    def _placed(self, topic: str) -> str:
        """Return where a topic of the bag is played: within this node's namespace, in which it may lie already."""
        namespace = self.get_namespace().rstrip("/")
        return topic if topic.startswith(f"{namespace}/") else namespace + topic

    def _seek(self, to_ns: int) -> bool:
        """Go to a time of the bag; return whether there is anything from there on.

        The last of the messages passed over that a late subscriber would get too are published.
        """
        passed = self._playback.seek(to_ns)
        self._clock_ns = 0
        if self._playback.next is None:
            return False
        for message in {one.topic: one for one in passed if graph.qos(one.topic) is graph.LATCHED}.values():
            self._outputs[message.topic].publish(message.data)
        return True

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
        return now - self._matched >= SETTLING * graph.slowness()

    def _publish(self, message: Message) -> None:
        if self._clock_output is not None and message.log_ns >= self._clock_ns:
            self._clock_output.publish(self._clock_form.filled(message.log_ns))
            self._clock_ns = message.log_ns + CLOCK_PERIOD_NS
        self._outputs[message.topic].publish(message.data)
        self._sent += 1

    def _end(self) -> None:
        """Begin again, or have done once the peers have taken what they were sent."""
        self._rounds += 1
        if self.get_parameter("loop").value:
            self._seek(self._begin_ns)
            return
        for output in self._outputs.values():
            output.wait_for_all_acked()
        self._finished = True
        self.get_logger().info(f"{self._sent} messages played from {self._bag}")

    def _offer_services(self) -> None:
        self.serve(Pause, "pause", lambda _: self._pause(True))
        self.serve(Resume, "resume", lambda _: self._pause(False))
        self.serve(TogglePaused, "toggle_paused", lambda _: self._pause(not self._playback.paused))
        self.serve(IsPaused, "is_paused", lambda _: {"paused": self._playback.paused})
        self.serve(GetRate, "get_rate", lambda _: {"rate": self.get_parameter("rate").value})
        self.serve(SetRate, "set_rate", self._set_rate)
        self.serve(PlayNext, "play_next", lambda _: {"success": self._step(1) == 1})
        self.serve(Burst, "burst", lambda request: {"actually_burst": self._step(request.num_messages)})
        self.serve(Seek, "seek", self._serve_seek)

    def _pause(self, paused: bool) -> None:
        self._playback.paused = paused

    def _set_rate(self, request: SetRate.Request) -> dict[str, bool]:
        (result,) = self.set_parameters([Parameter("rate", value=request.rate)])
        return {"success": result.successful}

    def _step(self, count: int) -> int:
        """Play some messages while the clock stands still, all that are left for zero; return how many there were."""
        played = 0
        while self._playback.paused and self._playback.next is not None and (played < count or not count):
            self._publish(self._playback.take())
            played += 1
        return played

    def _serve_seek(self, request: Seek.Request) -> dict[str, bool]:
        to_ns, before = request.time.sec * NANOSECONDS + request.time.nanosec, self._playback.next
        assert self._playback.first_ns is not None
        success = to_ns >= self._playback.first_ns and self._seek(to_ns)
        if not success and before is not None:
            self._playback.seek(before.log_ns)
        return {"success": success}

    def _status(self) -> tuple[list[str], dict[str, Any]]:
        problems = [] if self._listened() else ["nobody listens"]
        if problems and not self._begun:
            problems = ["nobody listens: waiting for a subscriber (with wait:=false, the bag is played to nobody)"]
        if self._playback.paused:
            problems.append("paused")
        return problems, {"messages": self._sent, "rate": self._rate, "rounds": self._rounds}


if __name__ == "__main__":
    sys.exit(run(Replayer))
