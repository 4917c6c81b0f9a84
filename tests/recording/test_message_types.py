"""Message types without ROS."""

from __future__ import annotations

import numpy as np

from elastic_arm.recording import message_types


def test_own_messages_match_their_ros_text() -> None:
    """Every .msg of elastic_arm_msgs parses, and an own message survives its round through CDR."""
    store = message_types.typestore()
    own = [name for name in store.fielddefs if name.startswith("elastic_arm_msgs/")]
    assert {"JointTorques", "ParameterEstimate", "GapDiagnosis"} <= {name.split("/")[-1] for name in own}
    for name in own:
        text, type_hash = message_types.definition(name)
        assert type_hash.startswith("RIHS01_")
        assert text
    torques = store.types["elastic_arm_msgs/msg/JointTorques"]
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](1, 2), "")
    given = torques(header, ["a"], np.array([1.0]), np.array([2.0]), np.zeros(0), np.array([0.26]))
    again = store.deserialize_cdr(store.serialize_cdr(given, torques.__msgtype__), torques.__msgtype__)
    assert again.motor_torque.tolist() == [2.0]
    assert again.header.stamp.nanosec == 2
