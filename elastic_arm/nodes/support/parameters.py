"""Parameters with a type, a range and a description, as `ros2 param describe` and rqt show them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
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


@dataclass(frozen=True)
class Setting:
    """A row of the table of parameters of a node. The type is that of the default; [] is a list of
    texts."""

    default: Any
    description: str
    between: tuple[float, float] | None = None
    choices: Sequence[str] = ()
    live: bool = False  # whether it may be changed while the node runs


# Those that several nodes have.
ROBOT = Setting("", "Nominal arm: file (YAML) or URDF; empty: the arm of the package")
MODEL = Setting("mod3", "Model of the arm", choices=("mod1", "mod2", "mod3"))
CHANNELS = Setting("", "Channel map (YAML) for the joint states of a driver: names, units")
SIDES = Setting("both", "Recorded channels of the arm", choices=("both", "link", "motor"))


def declared(node: Node, table: Mapping[str, Setting]) -> SimpleNamespace:
    """Declare the parameters of a table, and return their values by name."""
    return SimpleNamespace(**{name: _declare(node, name, row) for name, row in table.items()})


def _declare(node: Node, name: str, row: Setting) -> Any:
    descriptor = ParameterDescriptor(description=row.description, read_only=not row.live)
    if row.default == []:
        # An empty list has no type in ROS: as a default a list of one empty text stands for it.
        # Where the parameter may be set, it takes an empty list of whatever type `ros2 param set
        # NODE NAME "[]"` makes of it.
        descriptor.dynamic_typing = row.live
        if not row.live:
            descriptor.type = Parameter.Type.STRING_ARRAY.value
        return texts(node.declare_parameter(name, [""], descriptor).value)
    listed = isinstance(row.default, list)
    descriptor.type = (Parameter.Type.DOUBLE_ARRAY if listed else _TYPES[type(row.default)]).value
    if row.choices:
        descriptor.additional_constraints = "one of " + ", ".join(row.choices)
    if row.between and isinstance(row.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=row.between[0], to_value=row.between[1])
        ]
    elif row.between:
        low, high = map(int, row.between)
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
    value = node.declare_parameter(name, row.default, descriptor).value
    if row.choices and value not in row.choices:
        raise GraphError(
            f"parameter {name} is {value!r}", f"Choose one of {', '.join(row.choices)}."
        )
    return value


def texts(value: Any) -> list[str]:
    """Return the non-empty texts of a list parameter.

    Raises a GraphError if it is not a list of texts.
    """
    given = [] if value is None else value
    if (
        not isinstance(given, Sequence)
        or isinstance(given, str)
        or not all(isinstance(text, str) for text in given)
    ):
        raise GraphError(
            f"{given!r} is not a list of texts",
            "Write it as \"['first', 'second']\", or [] for none.",
        )
    return [text for text in given if text]
