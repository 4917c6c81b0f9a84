"""The drives of the joints in a compiled MuJoCo model: motor inertia, friction in motors, delays,
limits, controllers.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.robot.description import JointController, Limits
from elastic_arm.robot.mjcf.chain import MjcfChain, name_of
from elastic_arm.robot.mjcf.engine import engine

# <numeric> of an MJCF, of all joints, or with ":" and a joint's name of one.
FIRMWARE_GAIN = "firmware_gain"
WRITTEN = 1e-6  # relative, to which files state numbers that belong together


def motor_inertia_and_damping(model: Any, joint: int) -> tuple[float, float]:
    """Return armature (kg m²) and damping (Nm s/rad) of a joint.

    Those of an actuator that brings its own are included.
    """
    dof = int(model.jnt_dofadr[joint])
    actuator = int(model.jnt_actuatorid[joint])
    armature = float(model.dof_armature[dof])
    damping = float(model.dof_damping[dof])
    if actuator >= 0:
        gear = float(model.actuator_gear[actuator, 0])
        armature += gear**2 * float(model.actuator_armature[actuator])
        damping += gear**2 * float(model.actuator_damping[actuator])
    return armature, damping


def torque_delays(model: Any, chain: MjcfChain) -> Array:
    """Return by how much each joint's motor torque is late, (n,) s, by its sensor."""
    mj = engine().mjtSensor
    found = np.zeros(len(chain.joints))
    for k in range(model.nsensor):
        kind = int(model.sensor_type[k])
        at = int(model.sensor_objid[k])
        for i, joint in enumerate(chain.joints):
            measured = {
                int(mj.mjSENS_JOINTACTFRC): [joint],
                int(mj.mjSENS_ACTUATORFRC): drives_of(model, joint),
            }
            if at in measured.get(kind, ()):
                found[i] = float(model.sensor_delay[k])
    return found


def drives_of(model: Any, joint: int) -> list[int]:
    """Return the actuators that drive a joint."""
    return [k for k in _acting_on(model, joint) if not passive(model, k)]


def passive(model: Any, actuator: int) -> bool:
    """Return whether nobody commands an actuator.

    A `dcmotor` without inputs is friction and cogging.
    """
    return not model.actuator_ctrlnum[actuator]


def _acting_on(model: Any, joint: int) -> list[int]:
    kinds = (int(engine().mjtTrn.mjTRN_JOINT), int(engine().mjtTrn.mjTRN_JOINTINPARENT))
    # Not model.nu: an actuator may have several inputs.
    return [
        k
        for k, kind in enumerate(model.actuator_trntype)
        if int(kind) in kinds and model.actuator_trnid[k, 0] == joint
    ]


def joint_limits(model: Any, joint: int) -> Limits:
    lower, upper = (float(v) if model.jnt_limited[joint] else None for v in model.jnt_range[joint])
    torques = []
    for k in drives_of(model, joint):
        gear = abs(float(model.actuator_gear[k, 0]))
        if model.actuator_forcelimited[k]:
            torques.append(gear * float(np.abs(model.actuator_forcerange[k]).max()))
        elif model.actuator_ctrllimited[k] and not model.actuator_biasprm[k].any():
            gain = abs(float(model.actuator_gainprm[k, 0]))
            torques.append(gear * gain * float(np.abs(model.actuator_ctrlrange[k]).max()))
    if model.jnt_actfrclimited[joint]:
        torques.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return Limits(position_min=lower, position_max=upper, torque=min(torques, default=0.0) or None)


def controller_of(model: Any, joint: int) -> JointController | None:
    """Return the controller that the one actuator of a joint is.

    tau = kp (r - q) + kd (dr - dq) + ki int(r - q)

    An actuator of gain g and bias b1 q + b2 dq follows angles where g = -b1, and speeds where g =
    -b2. The number in the servo's register for which its gains hold is that of a <numeric>.
    """
    found = _controller(model, joint)
    gain = _firmware_gain(model, joint)
    return found if found is None or gain is None else replace(found, firmware_gain=gain)


def _firmware_gain(model: Any, joint: int) -> float | None:
    mj = engine()
    for name in (f"{FIRMWARE_GAIN}:{name_of(model, 'joint', joint)}", FIRMWARE_GAIN):
        numeric = mj.mj_name2id(model, mj.mjtObj.mjOBJ_NUMERIC, name)
        if numeric >= 0:
            return float(model.numeric_data[int(model.numeric_adr[numeric])])
    return None


def _controller(model: Any, joint: int) -> JointController | None:
    kind = _servo(model, joint)
    if kind is None:
        return _motor_with_firmware(model, joint)
    mode, k = kind
    gear = float(model.actuator_gear[k, 0])
    own = model.actuator_biasprm[k]
    gains = {"kp": -float(own[1]), "kd": -float(own[2])}
    if int(model.actuator_gaintype[k]) == int(engine().mjtGain.mjGAIN_PID):
        gains["ki"] = float(model.actuator_gainprm[k, 0])
    torque = _limit_of(model, k)
    scaled: dict[str, Any] = {name: gear**2 * gain for name, gain in gains.items()}
    return JointController(
        mode, delay=float(model.actuator_delay[k]), torque=torque or None, **scaled
    )


def follows_angles(model: Any, actuator: int) -> bool:
    """Return whether an actuator makes a torque of the error of an angle."""
    pos = int(engine().mjtCtrlInput.mjINPUT_POS)
    if int(model.actuator_gaintype[actuator]) == int(engine().mjtGain.mjGAIN_DCMOTOR):
        return int(model.actuator_ctrlspec[actuator]) == pos
    return float(model.actuator_biasprm[actuator, 1]) < 0.0


def _limit_of(model: Any, actuator: int) -> float | None:
    """Return the limit of an actuator's torque at its joint, Nm; None where it has none."""
    if not model.actuator_forcelimited[actuator]:
        return None
    gear = abs(float(model.actuator_gear[actuator, 0]))
    return gear * float(np.abs(model.actuator_forcerange[actuator]).max())


def _motor_with_firmware(model: Any, joint: int) -> JointController | None:
    """Return the controller that a `dcmotor` is whose firmware makes its voltage of the error of
    the angle.

    MuJoCo's own controller compensates the back-EMF, K w; a kd of K² / R takes that away again, as
    in a servo, whose voltage is proportional to the error alone:

        v = limit(R / K kp (r - q), Vmax),   tau = K / R (v - K w)
    """
    drives = drives_of(model, joint)
    dc = _dc_motors(model, joint)
    if len(drives) != 1 or drives[0] not in dc:
        return None
    (k,) = drives
    if int(model.actuator_ctrlspec[k]) != int(engine().mjtCtrlInput.mjINPUT_POS):
        return None
    resistance, constant, _, _, kp, ki, kd, most = map(float, model.actuator_gainprm[k, :8])
    damping = constant**2 / resistance
    compensated = np.isclose(kd, damping, rtol=WRITTEN)
    if not kp or ki or not compensated or model.actuator_dynprm[k, :5].any():
        return None
    gear = float(model.actuator_gear[k, 0])
    return JointController(
        kp=gear**2 * kp,
        kd=gear**2 * damping,
        delay=float(model.actuator_delay[k]),
        torque=_limit_of(model, k) or None,
        stall=abs(gear) * constant / resistance * most or None,
        supply=most or None,
    )


@dataclass(frozen=True)
class MotorConstants:
    """What a `dcmotor` states of a servo: K in Nm/A, R in Ohm and the supply in V, before its
    gear."""

    constant: float
    resistance: float
    supply: float

    @staticmethod
    def of(controller: JointController, gear: float) -> "MotorConstants":
        """Return the constants that make a controller's torque of full duty and its damping.

        Of a supply that is not known only its product with K / R acts: it is taken as 1 V.
        """
        assert controller.stall is not None
        supply = controller.supply or 1.0
        per_volt = controller.stall / abs(gear) / supply
        constant = controller.kd / gear**2 / per_volt
        return MotorConstants(constant, constant / per_volt, supply)


def set_controller(
    model: Any, actuator: int, before: JointController, after: JointController
) -> None:
    """Change gains, limits and delay of a compiled actuator from those of one controller to another
    one's."""
    gear = float(model.actuator_gear[actuator, 0])
    if int(model.actuator_gaintype[actuator]) == int(engine().mjtGain.mjGAIN_DCMOTOR):
        own = model.actuator_gainprm[actuator]
        own[4] = after.kp / gear**2
        own[6] = after.kd / gear**2
        if after.stall is not None:
            motor = MotorConstants.of(after, gear)
            own[:2] = motor.resistance, motor.constant
            own[7] = motor.supply
    else:
        kp = after.kp / before.kp
        model.actuator_gainprm[actuator, 0] *= kp
        model.actuator_biasprm[actuator, 1] *= kp
        if before.kd:
            model.actuator_biasprm[actuator, 2] *= after.kd / before.kd
    if before.torque and after.torque:
        model.actuator_forcerange[actuator] *= after.torque / before.torque
    room = float(model.actuator_history[actuator, 0] - 1) * float(model.opt.timestep)
    if room > 0.0:
        model.actuator_delay[actuator] = min(room, after.delay)


def _servo(model: Any, joint: int) -> tuple[str, int] | None:
    """Return "position", "velocity" or "both", and the actuator; None where it is no such
    controller."""
    mj = engine()
    drives = drives_of(model, joint)
    if len(drives) != 1:
        return None
    k = drives[0]
    gain = float(model.actuator_gainprm[k, 0])
    bias = model.actuator_biasprm[k]
    still = int(model.actuator_dyntype[k])
    b0, b1, b2 = (float(value) for value in bias[:3])
    if (
        int(model.actuator_biastype[k]) != int(mj.mjtBias.mjBIAS_AFFINE)
        or b0
        or min(-b1, -b2) < 0.0
    ):
        return None
    if int(model.actuator_gaintype[k]) == int(mj.mjtGain.mjGAIN_PID):
        # No limit of the integral, and none of how fast the set-point moves.
        return None if model.actuator_dynprm[k, :2].any() else ("both", k)
    if int(model.actuator_gaintype[k]) != int(mj.mjtGain.mjGAIN_FIXED) or still != int(
        mj.mjtDyn.mjDYN_NONE
    ):
        return None
    if b1 and gain == -b1:
        return "position", k
    return ("velocity", k) if b2 and not b1 and gain == -b2 else None


def motor_friction(model: Any, joint: int) -> tuple[float, float, float]:
    """Return friction of a joint's motors: dry, excess at rest (Nm), Stribeck speed (rad/s)."""
    dry = 0.0
    excess = 0.0
    speed = 0.0
    for k in _dc_motors(model, joint):
        gear = abs(float(model.actuator_gear[k, 0]))
        coulomb, static, stribeck = model.actuator_biasprm[k, 3:6]
        # the stiffness of LuGre's bristles; without, it has no friction
        if model.actuator_dynprm[k, 5] and gear:
            dry = dry + gear * coulomb
            excess = excess + gear * (static - coulomb)
            speed = stribeck / gear
    return float(dry), float(excess), float(speed)


def left_out(model: Any, joint: int) -> list[str]:
    """Return in sentences what the model states of a joint's drives and we do not hold."""
    notes = []
    label = name_of(model, "joint", joint)
    dc = _dc_motors(model, joint)
    drives = drives_of(model, joint)
    for k in dc:
        name = name_of(model, "actuator", k)
        gear = abs(float(model.actuator_gear[k, 0]))
        amplitude, waves = (float(v) for v in model.actuator_biasprm[k, :2])
        if model.actuator_dynprm[k, 5]:
            notes.append(
                f"LuGre friction of actuator {name} is read as Coulomb and Stribeck friction"
                f" of {label}: its bristles are ignored, and in MuJoCo it acts only together"
                " with the actuator"
            )
        if amplitude:
            notes.append(
                f"cogging of actuator {name}, {gear * amplitude:g} Nm at {label} and {waves:g}"
                " waves per turn of its rotor, is ignored: torque_ripple needs an arm file"
                " with transmissions"
            )
        if not passive(model, k) and controller_of(model, joint) is None:
            notes.append(
                f"actuator {name} is driven by voltage: a recorded motor torque corresponds to"
                " its current"
            )
        lag, volts, *thermal = model.actuator_dynprm[k, :5]
        electrical = {
            "inductance": lag,
            "limit of the voltage": volts,
            "thermal resistance": any(thermal),
        }
        if named := [what for what, value in electrical.items() if value]:
            notes.append(
                f"{', '.join(named)} of actuator {name}: ignored, as they act on the current"
            )
    fed_back = [
        k
        for k in drives
        if k not in dc and (model.actuator_biasprm[k].any() or model.actuator_dyntype[k])
    ]
    if fed_back and _servo(model, joint) is None:
        names = ", ".join(name_of(model, "actuator", k) for k in fed_back)
        notes.append(
            f"the controller of {label} ({names}) is ignored: it is not kp (r - q) + kd"
            " (dr - dq) + ki int(r - q) of one actuator"
        )
    if hasattr(model, "jnt_springyield") and float(model.jnt_springyield[joint]):
        notes.append(
            f"the spring of {label} yields at {float(model.jnt_springyield[joint]):g},"
            " which is ignored"
        )
    return notes


def _dc_motors(model: Any, joint: int) -> list[int]:
    kind = getattr(engine().mjtBias, "mjBIAS_DCMOTOR", None)  # of MuJoCo 3.6 and later
    return [
        k
        for k in _acting_on(model, joint)
        if kind is not None and int(model.actuator_biastype[k]) == int(kind)
    ]
