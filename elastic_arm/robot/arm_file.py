"""The fields of an arm file and their types; the description itself checks their values."""

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from elastic_arm.input_files import refuse_truth


def _number(value: Any) -> Any:
    """Accept what YAML 1.1 takes for text, like 1e5; refuse yes and no."""
    refuse_truth(value)
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            raise ValueError(f"is the text {value!r}, not a number") from None
    return value


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
# A limit that is infinite is none.
Limit = Annotated[
    Number | None, BeforeValidator(lambda v: None if str(v).lstrip("+-").lower() in _ENDLESS else v)
]
_ENDLESS = ("inf", ".inf", "infinity")
Vector = tuple[Number, Number, Number]
Row = tuple[Number, Number, Number, Number]
Matrix = tuple[Row, Row, Row, Row]
Name = Annotated[str, Field(min_length=1)]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class InertiaEntry(_Entry):
    """Symmetric tensor about the centre of mass, kg m^2."""

    xx: Number
    yy: Number
    zz: Number
    xy: Number = 0.0
    xz: Number = 0.0
    yz: Number = 0.0


class LinkEntry(_Entry):
    """A link in its own frame; named link_1, link_2, ... where it has no name."""

    name: Name | None = None
    mass: Number
    com: Vector
    inertia: InertiaEntry


class ComponentEntry(_Entry):
    """A rotor, wave generator or spline."""

    mass: Number
    izz: Number
    ixx: Number
    carrier: Name
    position: Vector = (0.0, 0.0, 0.0)
    frame: Literal["joint"] = "joint"
    kind: Literal["circular", "flex"] | None = None


class BearingEntry(_Entry):
    """Compliance about x and y."""

    stiffness: Number
    damping: Number


class DHEntry(_Entry):
    """Denavit-Hartenberg row."""

    a: Number
    d: Number
    alpha: Number
    offset: Number = 0.0


class LimitsEntry(_Entry):
    """Limits at the harmonic-drive output."""

    position_min: Limit = None
    position_max: Limit = None
    velocity: Limit = None
    acceleration: Limit = None
    torque: Limit = None


class MotorEntry(_Entry):
    """The electrics of a servo: `tau = torque_per_volt (supply duty - back_emf speed)`.

    The firmware makes `duty = duty_per_rad error`, at most 1; where the duty is recorded, this gain
    may be left out. All numbers are at the joint.
    """

    supply: Annotated[Number, Field(gt=0)]  # V
    torque_per_volt: Annotated[Number, Field(gt=0)]  # kt / R, Nm/V
    back_emf: Annotated[Number, Field(ge=0)]  # kt, V s/rad
    duty_per_rad: Annotated[Number, Field(gt=0)] | None = None

    def gains(self) -> dict[str, float]:
        """Return them as kp, kd and the torque of full duty."""
        stall = self.supply * self.torque_per_volt
        damping = self.torque_per_volt * self.back_emf
        gains = {"kp": stall * (self.duty_per_rad or 0.0), "kd": damping, "stall": stall}
        return gains | {"supply": self.supply}


class ControllerEntry(_Entry):
    """The controller of a joint's drive; `motor` instead of kp, kd and stall."""

    mode: Literal["position", "velocity", "both"] = "position"
    kp: Number = 0.0
    kd: Number = 0.0
    ki: Number = 0.0
    delay: Number = 0.0
    torque: Number | None = None
    feedforward: Literal["none", "gravity", "model"] = "none"
    between: Literal["held", "interpolated"] = "held"
    dead_band: Number = 0.0
    stall: Number | None = None
    sag: Number = 0.0
    supply: Number | None = None
    firmware_gain: Number | None = None
    motor: MotorEntry | None = None

    @model_validator(mode="after")
    def _once(self) -> Self:
        if self.motor is not None and (self.kp or self.kd or self.stall is not None):
            raise ValueError("give either motor, or kp, kd and stall")
        return self

    def numbers(self) -> dict[str, Any]:
        """Return the numbers of the controller, those of a motor as gains."""
        given = self.model_dump(exclude={"motor"})
        return given if self.motor is None else given | self.motor.gains()


class TransmissionEntry(_Entry):
    """What drives a joint: a whole transmission or none of it."""

    rotor: ComponentEntry | None = None
    wave_generator: ComponentEntry | None = None
    spline: ComponentEntry | None = None
    stiffness: Number | None = None
    damping: Number | None = None
    bearing: BearingEntry | None = None
    belt_ratio: Number | None = None
    harmonic_drive_ratio: Number | None = None


class JointEntry(TransmissionEntry):
    """A joint: placed by `dh` or by `before` and `after`; with a whole transmission or none.

    `armature` is the inertia of motor and gears at a joint without transmission, kg m^2. At a
    prismatic joint all numbers are linear ones: m, N, kg.
    """

    name: Name
    type: Literal["revolute", "prismatic"] = "revolute"
    dh: DHEntry | None = None
    before: Matrix | None = None
    after: Matrix | None = None
    link: LinkEntry
    limits: LimitsEntry = LimitsEntry()
    armature: Number | None = None


class BaseEntry(_Entry):
    """The base, placed by its Denavit-Hartenberg row or by `placement`.

    Otherwise it is at the ground's origin.
    """

    mass: Number = 0.0
    a: Number | None = None
    d: Number | None = None
    alpha: Number | None = None
    offset: Number | None = None
    placement: Matrix | None = None


class EffectEntry(_Entry):
    """What the arm has beyond mod3; the effects' own files define the parameters."""

    effect: Name
    joint: str | None = None
    parameters: dict[str, Any] = {}


class ArmEntry(_Entry):
    """The whole file."""

    name: Name
    gravity: Vector = (0.0, 0.0, -9.81)
    base: BaseEntry = BaseEntry()
    joints: Annotated[tuple[JointEntry, ...], Field(min_length=1)]
    total_ratios_studied: dict[Number, tuple[Number, Number]] = {}
    torque_noise_std: Number = 0.26
    sample_rate: Number = 1000.0
    effects: tuple[EffectEntry, ...] = ()
    controller: dict[str, ControllerEntry] = {}


class OverlayEntry(_Entry):
    """A URDF and what it cannot hold.

    `chain` is the arm's first and last link, base:tip; `transmissions`, `armature` (kg m^2),
    `limits` and `controller` are by the URDF's joint names.
    """

    urdf: Name
    chain: Annotated[str, Field(pattern=r"^[^:]+:[^:]+$")] | None = None
    name: Name | None = None
    gravity: Vector | None = None
    transmissions: dict[str, TransmissionEntry] = {}
    armature: dict[str, Annotated[Number, Field(ge=0)]] = {}
    limits: dict[str, LimitsEntry] = {}
    controller: dict[str, ControllerEntry] = {}
    total_ratios_studied: dict[Number, tuple[Number, Number]] | None = None
    torque_noise_std: Number | None = None
    sample_rate: Number | None = None
