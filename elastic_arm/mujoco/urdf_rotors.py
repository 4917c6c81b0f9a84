"""The inertia of motors in a URDF: Drake's tags, with the gear ratio in the file.

    armature = rotor_inertia gear_ratio²

The ratio is taken from Drake's `gear_ratio`, the `mechanicalReduction` of ROS 1 or the
`mechanical_reduction` of ros2_control; the latter two have no tag for the inertia.
"""

from typing import Any

from elastic_arm.mujoco.changed_numbers import text_of
from elastic_arm.mujoco.shape import append_last
from elastic_arm.robot.urdf_export import DRAKE


def state_rotor(root: Any, joint: str, armature: float, ratio: float) -> None:
    """State a joint's motor inertia, kg m² at the joint, in a URDF of lxml.

    A rotor that is stated changes, wherever it stands. Else it goes to the actuator of the joint's
    transmission, or to a new one.
    """
    inertia = armature / ratio**2
    transmissions = [
        one
        for one in root.iter("transmission")
        if any(part.get("name") == joint for part in one.iter("joint"))
    ]
    stated = [one for whole in transmissions for one in _named(whole, "rotor_inertia")]
    for element in stated:
        if element.get("value") is None:
            element.text = text_of(inertia)
        else:
            element.set("value", text_of(inertia))
    if stated:
        return
    # Drake reads what stands directly in <robot>, not what ros2_control has.
    actuators = [one.find("actuator") for one in transmissions if one.getparent() is root]
    actuator = next((one for one in actuators if one is not None), None)
    if actuator is None:
        actuator = _new_actuator(root, joint)
    _drake(actuator, "rotor_inertia", inertia)
    if not _named(actuator, "gear_ratio"):
        _drake(actuator, "gear_ratio", ratio)


def _new_actuator(root: Any, joint: str) -> Any:
    transmission = append_last(root, "transmission", {"drake": _namespace(root)})
    transmission.set("name", f"{joint}_rotor")
    append_last(transmission, "type").text = "transmission_interface/SimpleTransmission"
    append_last(transmission, "joint").set("name", joint)
    actuator = append_last(transmission, "actuator")
    actuator.set("name", f"{joint}_motor")
    return actuator


def _drake(actuator: Any, name: str, value: float) -> None:
    uri = _namespace(actuator)
    append_last(actuator, f"{{{uri}}}{name}", {"drake": uri}).set("value", text_of(value))


def _namespace(element: Any) -> str:
    return str(element.nsmap.get("drake", DRAKE))


def _named(parent: Any, name: str) -> list[Any]:
    """Return the elements below one by their name, of whatever namespace."""
    return [one for one in parent.iter() if str(one.tag).rpartition("}")[2] == name]
