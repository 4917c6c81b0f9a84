"""`ros2 run elastic_arm replayer`: plays a bag back onto its topics."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from functools import partial
from typing import Any

from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rosbag2_interfaces.srv import Burst, GetRate, IsPaused, Pause, PlayNext, Resume, Seek, SetRate, TogglePaused
from rosgraph_msgs.msg import Clock

from elastic_arm.errors import GraphError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.health import PERIOD, Health
from elastic_arm.nodes.support.parameters import declare, declare_texts
from elastic_arm.nodes.support.playback import Playback
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
RATES = (0.01, 100.0)


class Replayer(ArmNode):
    """Publishes the messages of a bag in the rhythm of their recording; its services are those of rosbag2's player."""

    def __init__(self) -> None:
        super().__init__("replayer")
        self._bag = declare(self, "bag", "", "Bag to play: rosbag2 folder, .mcap or .db3 file")
        wanted = declare_texts(self, "topics", "Topics to play; empty: all that are understood")
        self._rate = declare(self, "rate", 1.0, "Times the speed of the recording", between=RATES, live=True)
        self._loop = declare(self, "loop", False, "Begin again at the end", live=True)
        clock = declare(self, "clock", True, "Publish /clock")
        self._wait = declare(self, "wait", True, "Wait until somebody listens")
        offset = declare(self, "start_offset", 0.0, "Seconds of the bag to leave out at its start", between=(0.0, 1e6))
        paused = declare(self, "start_paused", False, "Begin with the clock standing still")
        if not self._bag:
            raise GraphError("parameter bag is empty", "Name a bag: -p bag:=FOLDER.")
        self._outputs = self._make_publishers(set(wanted))
        self._clock_output = self.create_publisher(Clock, topics.CLOCK, graph.qos(topics.CLOCK)) if clock else None
        self._clock_form = Form(topics.TYPES[topics.CLOCK], Clock())
        self._playback = Playback(lambda: read_messages(self._bag, set(self._outputs)))
        if self._playback.first_ns is None:
            raise GraphError(f"{self._bag} holds no messages on {', '.join(self._outputs)}", "Choose other topics.")
        self._begin_ns = self._playback.first_ns + round(offset * NANOSECONDS)
        self._sent = self._rounds = 0
        self._clock_ns = 0
        if not self._seek(self._begin_ns):
            raise GraphError(f"{self._bag} ends before {offset:g} s", "Choose a smaller start_offset.")
        self._playback.paused = paused
        self._begun = False
        self._matched: float | None = None
        self._finished = False
        self._offer_services()
        self._health = Health(self, "bag")
        self.every(PERIOD, self._report)

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
        """Go to a time of the bag; return whether there is anything from there on."""
        passed = self._playback.seek(to_ns)
        self._clock_ns = 0
        if self._playback.next is None:
            return False
        self._publish_latched(passed)
        return True

    def _publish_latched(self, passed: Iterable[Message]) -> None:
        """Publish the last of the messages passed over that a late subscriber would get too."""
        last = {message.topic: message for message in passed if graph.qos(message.topic) is graph.LATCHED}
        for message in last.values():
            self._outputs[message.topic].publish(message.data)

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
        services: dict[str, tuple[Any, Any]] = {
            "pause": (Pause, partial(self._pause, True)),
            "resume": (Resume, partial(self._pause, False)),
            "toggle_paused": (TogglePaused, partial(self._pause, None)),
            "is_paused": (IsPaused, self._is_paused),
            "get_rate": (GetRate, self._get_rate),
            "set_rate": (SetRate, self._set_rate),
            "play_next": (PlayNext, self._play_next),
            "burst": (Burst, self._play_burst),
            "seek": (Seek, self._serve_seek),
        }
        for name, (kind, serve) in services.items():
            self.create_service(kind, f"~/{name}", serve)

    def _pause(self, paused: bool | None, request: Any, response: Any) -> Any:
        """Service: stop the clock, let it go on, or the other of the two."""
        self._playback.paused = not self._playback.paused if paused is None else paused
        return response

    def _is_paused(self, request: IsPaused.Request, response: IsPaused.Response) -> IsPaused.Response:
        """Service: whether the clock stands still."""
        response.paused = self._playback.paused
        return response

    def _get_rate(self, request: GetRate.Request, response: GetRate.Response) -> GetRate.Response:
        """Service: times the speed of the recording."""
        response.rate = self.get_parameter("rate").value
        return response

    def _set_rate(self, request: SetRate.Request, response: SetRate.Response) -> SetRate.Response:
        """Service: the parameter `rate`."""
        (result,) = self.set_parameters([Parameter("rate", value=request.rate)])
        response.success = result.successful
        return response

    def _play_next(self, request: PlayNext.Request, response: PlayNext.Response) -> PlayNext.Response:
        """Service: play one message while the clock stands still."""
        response.success = self._step(1) == 1
        return response

    def _play_burst(self, request: Burst.Request, response: Burst.Response) -> Burst.Response:
        """Service: play some messages while the clock stands still, all that are left for zero."""
        response.actually_burst = self._step(request.num_messages)
        return response

    def _step(self, count: int) -> int:
        played = 0
        while self._playback.paused and self._playback.next is not None and (played < count or not count):
            self._publish(self._playback.take())
            played += 1
        return played

    def _serve_seek(self, request: Seek.Request, response: Seek.Response) -> Seek.Response:
        """Service: go to a time of the bag."""
        to_ns, before = request.time.sec * NANOSECONDS + request.time.nanosec, self._playback.next
        assert self._playback.first_ns is not None
        response.success = to_ns >= self._playback.first_ns and self._seek(to_ns)
        if not response.success and before is not None:
            self._playback.seek(before.log_ns)
        return response

    def _report(self) -> None:
        problems = [] if self._listened() else ["nobody listens"]
        if problems and not self._begun:
            problems = ["nobody listens: waiting for a subscriber (with wait:=false, the bag is played to nobody)"]
        if self._playback.paused:
            problems.append("paused")
        self._health.report(problems, "playing", {"messages": self._sent, "rate": self._rate, "rounds": self._rounds})


if __name__ == "__main__":
    sys.exit(run(Replayer))
