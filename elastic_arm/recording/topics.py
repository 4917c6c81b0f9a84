"""The names that every recording and every live graph uses; an arm in a namespace has them below
it."""

JOINT_STATES = "/joint_states"
MOTOR_STATES = "/motor_states"
JOINT_TORQUES = "/joint_torques"
MOTOR_PWM = "/motor_pwm"
MOTOR_SUPPLY = "/motor_supply"
REFERENCE = "/reference"
PARAMETER_ESTIMATE = "/parameter_estimate"
GAP = "/gap"
DIAGNOSTICS = "/diagnostics"
ROBOT_DESCRIPTION = "/robot_description"
CLOCK = "/clock"
TRANSFORMS = "/tf"

# Channels that only motors have: the effort of a topic of their own.
OF_MOTOR = {"pwm": MOTOR_PWM, "supply": MOTOR_SUPPLY}

TYPES = {
    JOINT_STATES: "sensor_msgs/msg/JointState",
    MOTOR_STATES: "sensor_msgs/msg/JointState",
    JOINT_TORQUES: "elastic_arm_msgs/msg/JointTorques",
    MOTOR_PWM: "sensor_msgs/msg/JointState",
    MOTOR_SUPPLY: "sensor_msgs/msg/JointState",
    REFERENCE: "trajectory_msgs/msg/JointTrajectory",
    PARAMETER_ESTIMATE: "elastic_arm_msgs/msg/ParameterEstimate",
    GAP: "elastic_arm_msgs/msg/GapDiagnosis",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    ROBOT_DESCRIPTION: "std_msgs/msg/String",
    CLOCK: "rosgraph_msgs/msg/Clock",
}

# where links are no node says: it is for viewers
_IN_BAGS = {**TYPES, TRANSFORMS: "tf2_msgs/msg/TFMessage"}


def type_of(topic: str) -> str:
    """Return the message type of a topic; one that is not the suite's own holds joint states."""
    return _IN_BAGS.get(topic, "sensor_msgs/msg/JointState")


# Not an arm's but the graph's: the same in every namespace.
GLOBAL = frozenset({CLOCK, DIAGNOSTICS})
# A late subscriber still gets the last message of these.
LATCHED = frozenset({ROBOT_DESCRIPTION})
# Messages that may pile up on the others: after the machine was busy a simulator catches up,
# and a subscriber may be writing to a disk, or making an estimate.
STREAM_DEPTH = 5000
