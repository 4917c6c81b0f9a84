"""All errors that users can meet.

They have one base class, so that an entry point (command line, node) catches exactly these. Each
error states the problem and the remedy, and has the wrong values as attributes.
"""

from importlib.util import find_spec

# Packages of ROS 2 that nodes import.
_ROS = (
    *(
        "rclpy",
        "builtin_interfaces",
        "control_msgs",
        "diagnostic_msgs",
        "elastic_arm_msgs",
        "rcl_interfaces",
    ),
    *("rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs"),
)
_LONGEST = 1000  # characters of a problem, a remedy or a finding


class ElasticArmError(Exception):
    """Base of all errors that a user can mend.

    problem: what is wrong, naming the file, field, topic, joint or time.
    """

    def __init__(self, problem: str, remedy: str = "") -> None:
        self.problem = one_line(problem)
        self.remedy = one_line(remedy)
        super().__init__(" ".join(_sentence(part) for part in (self.problem, self.remedy) if part))


def one_line(text: str) -> str:
    """Return `text` as one line of bounded length.

    It may hold names out of files and messages: what would break the line or control a terminal is
    written as its code.
    """
    if len(text) > _LONGEST:
        text = f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 2 :]}"
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


def _sentence(text: str) -> str:
    """Return `text` with a full stop, unless it ends a sentence already."""
    return text if text.endswith((".", "?", "!")) else f"{text}."


def require_kind(
    value: object, kind: type, name: str, error: type[ElasticArmError], remedy: str
) -> None:
    """Refuse an argument of another type where a user's program hands it in, not deep inside.

    value, kind: what was given, and the class that it has to be of.

    Raises an ElasticArmError as `error`, if the value is of another type.
    """
    if not isinstance(value, kind):
        found = "None" if value is None else f"of type {type(value).__name__}"
        raise error(f"{name} is {found}, not a {kind.__name__}", remedy)


class RobotError(ElasticArmError, ValueError):
    """A robot description (arm file or URDF) that cannot be used."""


class KernelError(ElasticArmError, RuntimeError):
    """Generated code that cannot be compiled or loaded on this machine."""


class RecordingError(ElasticArmError, ValueError):
    """A recording that cannot be read, or lacks what is needed of it."""


class ExcitationError(ElasticArmError, ValueError):
    """A trajectory that breaks the limits, or a search that found none within them."""


class SensorError(ElasticArmError, ValueError):
    """Settings of a sensor that make no sense."""


class SimulationError(ElasticArmError, RuntimeError):
    """A simulation that left the finite numbers."""


class IdentificationError(ElasticArmError, ValueError):
    """Data from which the wanted parameters cannot be identified."""


class EffectError(ElasticArmError, ValueError):
    """An unmodelled effect that does not exist, or whose parameters make no sense."""


class DiagnosisError(ElasticArmError, ValueError):
    """Data or options from which no diagnosis can be made."""


class OutputError(ElasticArmError, OSError):
    """A result that cannot be written, or would overwrite an earlier one."""


class GraphError(ElasticArmError, RuntimeError):
    """A live graph, or a node's parameter, that is not as the node needs it."""


class MissingExtraError(ElasticArmError, ImportError):
    """An optional library that this command needs is not installed."""


# The extra of setup.py that brings a library which few commands need.
EXTRAS = {
    "distributed": "cluster",
    "pandas": "notebook",
    "pin": "challenge",
    "pyarrow": "learning",
    "sympy": "paper",
    "usd-core": "usd",
}


def require_libraries(what: str, *names: str, remedy: str = "") -> None:
    """Raise if libraries are missing, and name all of them and their extras at once.

    `what` is subject and verb of the error.

    Names are those of imports, or of the distribution and its import where these differ:
    ``"pin:pinocchio"``.
    """
    missing = [name.split(":")[0] for name in names if find_spec(name.split(":")[-1]) is None]
    if missing:
        raise MissingExtraError(
            f"{what} {', '.join(missing)}: not installed here", remedy or _installation(missing)
        )


def _installation(missing: list[str]) -> str:
    """Return the command that installs libraries, and the extras that would have brought them."""
    command = f"Run: pip install {' '.join(missing)}"
    extras = [f"`{EXTRAS[name]}`" for name in missing if name in EXTRAS]
    if not extras:
        return command
    return f"{command} (extra {', '.join(extras)}), or `make setup` in a clone"


def require_ros(what: str) -> None:
    """Refuse where ROS 2 or packages of it are missing; `what` is subject and verb of the error."""
    remedy = "Run `make setup` and `. tools/env.sh`, or source the set-up of your ROS 2 workspace"
    if find_spec("rclpy") is None:
        raise MissingExtraError(f"{what} ROS 2, which is not installed here", remedy)
    require_libraries(f"{what} packages of ROS 2:", *_ROS, remedy=remedy)
