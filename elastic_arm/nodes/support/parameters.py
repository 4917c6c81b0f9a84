"""Parameters with a type, a range and a description, as `ros2 param describe` and rqt show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from elastic_arm.errors import GraphError

_TYPES = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}


def declare(
    node: Node,
    name: str,
    default: bool | int | float | str,
    description: str,
    *,
    between: tuple[float, float] | None = None,
    choices: Sequence[str] = (),
    live: bool = False,
) -> Any:
    """Declare a parameter and return its value.

    node, name, default, description: of the parameter; its type is that of the default; live: whether it may be
    changed while the node runs.
    """
    descriptor = ParameterDescriptor(description=description, read_only=not live, type=_TYPES[type(default)].value)
    if choices:
        descriptor.additional_constraints = "one of " + ", ".join(choices)
    if between and isinstance(default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=between[0], to_value=between[1])]
    elif between:
        descriptor.integer_range = [IntegerRange(from_value=int(between[0]), to_value=int(between[1]))]
    value = node.declare_parameter(name, default, descriptor).value
    if choices and value not in choices:
        raise GraphError(f"parameter {name} is {value!r}", f"Choose one of {', '.join(choices)}.")
    return value


def declare_texts(node: Node, name: str, description: str, *, live: bool = False) -> list[str]:
    """Declare a list of texts, empty by default, and return it.

    An empty list has no type in ROS: as a default a list of one empty text stands for it. Where the parameter may be
    set, it takes an empty list of whatever type `ros2 param set NODE NAME "[]"` makes of it.
    """
    descriptor = ParameterDescriptor(description=description, read_only=not live, dynamic_typing=live)
    if not live:
        descriptor.type = Parameter.Type.STRING_ARRAY.value
    return texts(node.declare_parameter(name, [""], descriptor).value)


def declare_numbers(node: Node, name: str, default: list[float], description: str) -> list[float]:
    """Declare a list of numbers and return it."""
    descriptor = ParameterDescriptor(description=description, read_only=True, type=Parameter.Type.DOUBLE_ARRAY.value)
    return list(node.declare_parameter(name, default, descriptor).value)


def texts(value: Any) -> list[str]:
    """Return the texts of a list parameter that are not empty.

    Raises a GraphError if it is no list of texts.
    """
    given = [] if value is None else value
    if not isinstance(given, Sequence) or isinstance(given, str) or not all(isinstance(text, str) for text in given):
        raise GraphError(f"{given!r} is no list of texts", "Write it as \"['first', 'second']\", or [] for none.")
    return [text for text in given if text]
