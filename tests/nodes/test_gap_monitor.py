"""The gap monitor: the process beside it, its messages, and the node on a real DDS graph."""

import json
import math
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from elastic_arm_msgs.msg import GapDiagnosis
from std_srvs.srv import SetBool, Trigger

from elastic_arm import SimulationSettings, load_robot, simulate, write_recording
from elastic_arm.diagnosis.estimates import ParameterEstimate
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.nodes.support.gap_messages import diagnosis_message, in_words
from elastic_arm.nodes.support.worker_process import Answer, WorkerProcess
from tests.helpers.questions import halving
from tests.helpers.ros_graph import Graph

TORQUE = 6.0


# The process beside the node


def answer_of(worker: WorkerProcess) -> Answer:
    end = time.monotonic() + 30.0
    while (answer := worker.answer()) is None:
        assert time.monotonic() < end, "no answer"
        time.sleep(0.01)
    return answer


@pytest.fixture
def worker() -> Iterator[WorkerProcess]:
    made = WorkerProcess(halving, 2)
    yield made
    made.close()


def test_questions_are_answered_in_another_process(worker: WorkerProcess) -> None:
    """The answer comes from a process of its own, and until then the asker goes on."""
    assert worker.answer() is None
    worker.ask(8)
    assert worker.busy
    process, half = answer_of(worker).value
    assert (process != os.getpid(), half) == (True, 4.0)
    assert not worker.busy


def test_a_question_that_cannot_be_answered_is_said_in_words(worker: WorkerProcess) -> None:
    """An error of the library is an answer; the next question is answered again."""
    worker.ask(1)
    assert answer_of(worker) == Answer(problem="1 is too small. Take more.")
    worker.ask(4)
    assert answer_of(worker).value[1] == 2.0


def test_a_process_that_dies_is_started_again(worker: WorkerProcess) -> None:
    """Its end is a problem that names the exit code and is counted; the next question is answered
    by a new process."""
    worker.ask(8)
    first, _ = answer_of(worker).value
    worker.ask(0)
    assert "code 3" in answer_of(worker).problem
    assert (worker.busy, worker.restarts) == (False, 1)
    worker.ask(4)
    second, half = answer_of(worker).value
    assert half == 2.0 and second != first


# Messages

FOUND: dict[str, Any] = {
    "schema": "elastic_arm/diagnosis/2",
    "model": "mod3",
    "robot": "arm",
    "recordings": {"identify": ["live"], "validate": ["live"], "independent_motion": True},
    "band_hz": [0.0, 40.0],
    "verdict": "explained",
    "noise": {"joint_1": {"link": 0.1, "drive": None, "motor": 0.3}},
    "gap": {
        "before": {
            "joint_1": {
                "link": {"rmse": 1.0, "max": 2.0},
                "drive": None,
                "motor": {"rmse": 3.0, "max": 4.0},
            }
        },
        "after": {
            "joint_1": {
                "link": {"rmse": 0.1, "max": 0.2},
                "drive": None,
                "motor": {"rmse": 0.3, "max": 0.4},
            }
        },
    },
    "shrink": 0.9,
    "shrink_interval": [0.8, 0.95],
    "causes": [
        {
            "effect": "time_delay",
            "joint": None,
            "sides": ["link", "drive"],
            "regime": "always",
            "parameters": {
                "delay": {"value": 0.004, "std": 1e-5, "unit": "s"},
                "channels": {"value": ["joint_torque"], "std": None, "unit": ""},
            },
            "shrink": 0.9,
            "confidence": 0.8,
            "from": {"delay": 0.001},
            "to": {"delay": 0.004},
            "alternatives": [
                {
                    "effect": "damping_mismatch",
                    "joint": "joint_1",
                    "confidence": 0.2,
                    "separated_by": "faster motion",
                }
            ],
        }
    ],
    "unexplained": [{"joint": "joint_1", "side": "motor", "regime": "load", "rmse": 0.5}],
    "changes": [
        {
            "effect": "time_delay",
            "joint": None,
            "parameter": "delay",
            "unit": "s",
            "values": [
                {"recording": "a", "value": 0.004, "std": 1e-5},
                {"recording": "b", "value": 0.002, "std": 1e-5},
            ],
            "confidence": 0.99,
        }
    ],
    "trust": {"as measured": 0.2, "as built": 0.8},
}


def test_a_message_says_what_the_file_says() -> None:
    """Every field of diagnosis.json is in the message; null becomes NaN, no joint an empty name."""
    message = diagnosis_message(FOUND)
    assert (message.verdict, message.model, message.robot, message.shrink) == (
        "explained",
        "mod3",
        "arm",
        0.9,
    )
    assert list(message.shrink_interval) == [0.8, 0.95]
    sizes = {
        r.side: (r.noise, r.rmse_before, r.max_before, r.rmse_after, r.max_after)
        for r in message.residuals
    }
    assert sizes["motor"] == (0.3, 3.0, 4.0, 0.3, 0.4)
    assert all(map(math.isnan, sizes["drive"]))
    (cause,) = message.causes
    assert (cause.effect, cause.joint, list(cause.sides), cause.confidence) == (
        "time_delay",
        "",
        ["link", "drive"],
        0.8,
    )
    delay, channels = cause.parameters
    assert (delay.name, list(delay.value), list(delay.std), delay.unit) == (
        "delay",
        [0.004],
        [1e-5],
        "s",
    )
    assert (list(delay.stated), list(channels.stated)) == ([0.001], [])
    assert (list(channels.words), list(channels.value)) == (["joint_torque"], [])
    (other,) = cause.alternatives
    assert (other.effect, other.joint, other.separated_by) == (
        "damping_mismatch",
        "joint_1",
        "faster motion",
    )
    (place,) = message.unexplained
    assert (place.joint, place.side, place.regime, place.rmse) == ("joint_1", "motor", "load", 0.5)
    (change,) = message.changes
    assert (change.effect, change.joint, change.parameter, change.confidence) == (
        "time_delay",
        "",
        "delay",
        0.99,
    )
    assert (list(change.recording), list(change.value)) == (["a", "b"], [0.004, 0.002])
    assert dict(zip(message.trust, message.trust_probability, strict=True)) == FOUND["trust"]
    assert in_words(FOUND) == "explained: time_delay"


def test_the_log_has_a_verdict_in_words() -> None:
    """Of an unknown the largest place is said beside the causes, or alone; of a sound arm that it
    is one."""
    left = (
        "the largest unexplained residual, at joint_1 (motor side), depends on the load of the"
        " joint; to find its law, move joint_1 alone: one path with and without a known weight at"
        " the flange"
    )
    assert in_words({**FOUND, "verdict": "unknown"}) == f"unknown: time_delay; {left}"
    assert in_words({**FOUND, "verdict": "unknown", "causes": []}) == f"unknown: {left}"
    sound = {**FOUND, "verdict": "none", "causes": [], "unexplained": []}
    assert in_words(sound) == (
        "none: the arm moves like its model, within noise and usual tolerances"
    )


def test_no_gap_is_a_message_too() -> None:
    """Where nothing stands out there is no shrink: NaN, and no cause."""
    message = diagnosis_message(
        {**FOUND, "verdict": "none", "shrink": None, "shrink_interval": None, "causes": []}
    )
    assert message.verdict == GapDiagnosis.NONE
    assert math.isnan(message.shrink)
    assert all(map(math.isnan, message.shrink_interval))


def test_a_vector_has_its_components() -> None:
    """A parameter with three components, such as where a payload sits, keeps them."""
    payload = ParameterEstimate(np.array([0.1, 0.2, 0.3]), np.array([0.01, 0.02, 0.03]), "m")
    parameters = {"position": {"value": list(payload.value), "std": list(payload.std), "unit": "m"}}
    message = diagnosis_message(
        {**FOUND, "causes": [{**FOUND["causes"][0], "parameters": parameters}]}
    )
    (position,) = message.causes[0].parameters
    assert list(position.value) == [0.1, 0.2, 0.3]
    assert list(position.std) == [0.01, 0.02, 0.03]


# The node


EFFECT = f"coulomb_friction:joint_2:torque={TORQUE}"


def swinging() -> FourierTrajectory:
    """Return a motion of 20 s that shows friction."""
    a, b = np.random.default_rng(5).normal(0.0, 0.3, (2, 3, 5))
    return FourierTrajectory(
        2 * np.pi / 20.0, a, b, np.zeros(3), 20.0, 0.5, ("joint_1", "joint_2", "joint_3")
    )


def start_arm(graph: Graph) -> None:
    """Start an arm that has more friction than its model and moves on and on."""
    swinging().save(graph.folder / "trajectory.yaml")
    graph.start(
        "simulator", effects=f"['{EFFECT}']", real_time_factor=0.8, initial_position="[0.0]"
    )
    graph.start(
        "trajectory_generator",
        trajectory=graph.folder / "trajectory.yaml",
        repeat=0,
        use_sim_time=True,
    )


@pytest.mark.graph
def test_the_friction_of_a_moving_arm_is_named(graph: Graph) -> None:
    """While the arm moves, /gap names effect, joint and size, and losses are counted aloud.

    That none are lost is for `bench_live` to show: a machine that tests share may starve any
    subscriber.
    """
    found = graph.listen(GapDiagnosis, "/gap")
    status = graph.status("gap_monitor")
    window = 8.0
    monitor = graph.start(
        "gap_monitor", window=window, period=5.0, save_to=graph.folder / "diagnosis"
    )
    assert not graph.call(Trigger, "/gap_monitor/save", Trigger.Request()).success
    start_arm(graph)
    named: list[GapDiagnosis] = []

    def settled() -> bool:
        named[:] = [m for m in found if any(c.effect == "coulomb_friction" for c in m.causes)]
        return bool(named)

    graph.until(settled, "the friction is named", patience=120)
    (cause,) = [c for c in named[0].causes if c.effect == "coulomb_friction"]
    assert cause.joint == "joint_2"
    torque = {p.name: p for p in cause.parameters}["torque"]
    assert torque.value[0] == pytest.approx(TORQUE, rel=0.05)
    assert named[0].header.stamp.sec > 0
    assert graph.call(Trigger, "/gap_monitor/save", Trigger.Request()).success
    saved = json.loads((graph.folder / "diagnosis" / "diagnosis.json").read_text())
    assert (saved["schema"], saved["model"]) == (found[0].schema, found[0].model)
    assert graph.call(SetBool, "/gap_monitor/pause", SetBool.Request(data=True)).success
    graph.until(lambda: "paused" in status["said"], "the pause is reported")
    assert {status[f"samples {loss}"] for loss in ("late", "repeated")} == {"0"}
    assert int(status["samples unmatched"]) < 0.1 * 1000 * window, (
        "what was diagnosed is the arm's motion"
    )
    assert graph.call(Trigger, "/gap_monitor/reset", Trigger.Request()).success
    graph.until(lambda: status["buffered time, s"] == "0", "all is forgotten")
    assert monitor.stop() == 0, monitor.output
    assert "Traceback" not in monitor.output


@pytest.mark.graph
def test_a_replay_shorter_than_the_window_is_diagnosed_at_its_end(graph: Graph) -> None:
    """12 s of samples for a window of 15 s: when no more come, what came is diagnosed, once."""
    settings = SimulationSettings(effects=[EFFECT])
    rng = np.random.default_rng(1)
    write_recording(
        graph.folder / "short", simulate(load_robot(), swinging(), settings, duration=12.0, rng=rng)
    )
    found = graph.listen(GapDiagnosis, "/gap")
    graph.start("gap_monitor")
    graph.start("replayer", bag=graph.folder / "short", rate=3.0)
    graph.until(lambda: found, "the bag is diagnosed", patience=120)
    (cause,) = [c for c in found[0].causes if c.effect == "coulomb_friction"]
    assert (cause.joint, cause.parameters[0].value[0]) == (
        "joint_2",
        pytest.approx(TORQUE, rel=0.05),
    )


@pytest.mark.graph
def test_an_arm_at_rest_is_not_diagnosed(graph: Graph) -> None:
    """Without motion there is no verdict, and the reason stands on /diagnostics; Ctrl-C ends the
    node at any time."""
    found = graph.listen(GapDiagnosis, "/gap")
    status = graph.status("gap_monitor")
    monitor = graph.start("gap_monitor", window=8.0)
    graph.start("simulator", real_time_factor=0.8)
    graph.until(lambda: "no motion" in status.get("said", ""), "the rest is reported")
    assert not found
    assert monitor.stop(signal.SIGTERM) == 0, monitor.output
