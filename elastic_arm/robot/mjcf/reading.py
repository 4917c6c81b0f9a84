"""A robot with the same equations of motion as a compiled MuJoCo model.

Link i has the frame of the body that carries joint i. Bodies without a joint of the chain, and
bodies with locked joints, are part of the link that carries them. The robot has MuJoCo's numbers:
armatures, and damping, friction loss, springs and gravity compensation as effects of the sizes in
the model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.errors import RobotError
from elastic_arm.robot.description import Inertia, Joint, Robot
from elastic_arm.robot.kinematics import lumped, moved
from elastic_arm.robot.mjcf.chain import MjcfChain, find_chain, joints_of, name_of, slides
from elastic_arm.robot.mjcf.drives import (
    controller_of,
    joint_limits,
    left_out,
    motor_friction,
    motor_inertia_and_damping,
    torque_delays,
)
from elastic_arm.robot.mjcf.engine import compiled, engine
from elastic_arm.robot.parts import located, moved_joint, placed
from elastic_arm.robot.urdf_elements import z_onto
from elastic_arm.robot.urdf_tree import Chain


@dataclass(frozen=True, eq=False)
class MjcfArm:
    """An arm in a compiled MuJoCo model."""

    model: Any  # `MjModel`
    chain: MjcfChain  # which of its bodies and joints are the arm
    # (nq,) positions at which what is outside the chain is held; chain joints at their reference
    qpos: Array
    robot: Robot  # the arm as data
    # friction laws of it that no number of the model states, for those that play it step by step
    laws: tuple[Any, ...] = ()

    @property
    def positions(self) -> Indices:
        """Where the chain's angles stand in MuJoCo's qpos, (n,)."""
        return np.asarray(self.model.jnt_qposadr[list(self.chain.joints)], dtype=np.intp)

    @property
    def dofs(self) -> Indices:
        """Where their rates stand in qvel, (n,)."""
        return np.asarray(self.model.jnt_dofadr[list(self.chain.joints)], dtype=np.intp)


def read_mjcf(path: str | Path, chain: Chain | None = None, at: str | None = None) -> Robot:
    """Read the arm of an MJCF file; see :func:`open_mjcf`."""
    return open_mjcf(path, chain, at).robot


def open_mjcf(path: str | Path, chain: Chain | None = None, at: str | None = None) -> MjcfArm:
    """Read an MJCF file, with what it includes, and find the arm in it.

    `chain` names first and last body of the arm; what stands on its links is held and part of them.
    `at` states where joints outside the chain are held: a keyframe's name, or `joint=value,…` in
    MuJoCo's units (m, rad); at their reference positions when None. Raises a RobotError if MuJoCo
    refuses the model, or it holds no serial chain of hinges and slides; it names element, reason
    and remedy.
    """
    path = Path(path)
    with located(f"{path}: "):
        model, notes, armatures = compiled(path)
        found = find_chain(model, chain)
        qpos = _held_positions(model, found, at)
        name = getattr(model, "names", b"").split(b"\0", 1)[0].decode(errors="replace") or path.stem
        return MjcfArm(model, found, qpos, _robot(name, model, found, qpos, notes, armatures))


def _held_positions(model: Any, chain: MjcfChain, at: str | None) -> Array:
    """Return qpos with the joints outside the chain where `at` holds them."""
    mj = engine()
    qpos: Array = np.array(model.qpos0, dtype=float)
    if at:
        if not at.isprintable():
            raise RobotError(
                f"at: {at!r} is not text", "Give joint=value,…, or the name of a keyframe"
            )
        key = mj.mj_name2id(model, mj.mjtObj.mjOBJ_KEY, at)
        if key >= 0:
            qpos[:] = model.key_qpos[key]
        else:
            for name, value in _assignments(at, model).items():
                qpos[int(model.jnt_qposadr[mj.mj_name2id(model, mj.mjtObj.mjOBJ_JOINT, name)])] = (
                    value
                )
    for play in chain.plays:
        qpos[int(model.jnt_qposadr[play])] = model.jnt_range[play].mean()
    addresses = [int(model.jnt_qposadr[joint]) for joint in chain.joints]
    qpos[addresses] = model.qpos0[addresses]
    return qpos


def _assignments(at: str, model: Any) -> Mapping[str, float]:
    """Read `joint=value,…`."""
    mj = engine()
    scalar = (int(mj.mjtJoint.mjJNT_HINGE), int(mj.mjtJoint.mjJNT_SLIDE))
    known = [
        name_of(model, "joint", j) for j in range(model.njnt) if int(model.jnt_type[j]) in scalar
    ]
    found = {}
    for part in at.split(","):
        name, equals, text = (word.strip() for word in part.partition("="))
        keys = ", ".join(name_of(model, "key", k) for k in range(model.nkey)) or "none"
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not equals or name not in known or not np.isfinite(value):
            raise RobotError(
                f"at: cannot read {part!r}",
                f"Give joint=value,… with joints among {', '.join(known)}, or the name of a"
                f" keyframe ({keys})",
            )
        found[name] = value
    return found


def _robot(
    name: str, model: Any, chain: MjcfChain, qpos: Array, notes: list[str], armatures: bool
) -> Robot:
    mj = engine()
    data = mj.MjData(model)
    data.qpos[:] = qpos
    mj.mj_kinematics(model, data)
    frames = _joint_frames(model, data, chain)
    carriers = [placed(data.xmat[body], data.xpos[body]) for body in _carriers(model, chain)]
    bodies = _link_bodies(model, data, chain, carriers)
    joints = []
    for i, joint in enumerate(chain.joints):
        label = name_of(model, "joint", joint)
        slid = slides(model, joint)
        # What takes back the angle or travel at which a model is drawn.
        back = moved_joint(-float(model.qpos0[model.jnt_qposadr[joint]]), slid)
        previous = np.eye(4) if i == 0 else carriers[i - 1]
        before = (
            np.linalg.inv(_base(data, chain)) if i == 0 else np.linalg.inv(previous)
        ) @ frames[i]
        after = back @ np.linalg.inv(frames[i]) @ carriers[i]
        with located(f"joint {label!r}: "):
            armature, _ = motor_inertia_and_damping(model, joint)
            link = _link_name(model, chain, i)
            moving: dict[str, Any] = {
                "limits": joint_limits(model, joint),
                "controller": controller_of(model, joint),
            }
            # MuJoCo's default of zero states nothing where the file has no armature at all.
            moving |= {"armature": armature if armature or armatures else None, "prismatic": slid}
            joints.append(Joint(label, link, bodies[i], before, after, **moving))
    if joints[-1].link.mass == 0.0:
        raise RobotError(
            f"body {joints[-1].link_name!r} has no mass",
            "Give it an <inertial>, or select a shorter chain",
        )
    return Robot(
        name,
        tuple(joints),
        gravity=_gravity(model),
        base_placement=_base(data, chain),
        base_mass=float(model.body_mass[chain.base]) if chain.base else 0.0,
        effects=tuple(_effects(model, data, chain, carriers, [joint.name for joint in joints])),
        notes=(*notes, *_notes(model, chain)),
    )


def _gravity(model: Any) -> Array:
    off = int(model.opt.disableflags) & int(engine().mjtDisableBit.mjDSBL_GRAVITY)
    return np.zeros(3) if off else np.array(model.opt.gravity, dtype=float)


def _base(data: Any, chain: MjcfChain) -> Array:
    return placed(data.xmat[chain.base], data.xpos[chain.base])


def _carriers(model: Any, chain: MjcfChain) -> list[int]:
    """Return the body that each joint of the chain belongs to."""
    return [int(model.jnt_bodyid[joint]) for joint in chain.joints]


def _link_name(model: Any, chain: MjcfChain, i: int) -> str:
    """Return the body's name; of several joints of one body the last moves it, those before
    massless links."""
    bodies = _carriers(model, chain)
    name = name_of(model, "body", bodies[i])
    later = bodies[i + 1 :].count(bodies[i])
    name = f"{name}_before_{name_of(model, 'joint', chain.joints[i + 1])}" if later else name
    return f"{name}_link" if name == "base" else name


def _joint_frames(model: Any, data: Any, chain: MjcfChain) -> list[Array]:
    """Return the frames (4, 4) of the chain's joints in the world, z along the axis."""
    frames = []
    for joint, body in zip(chain.joints, _carriers(model, chain), strict=True):
        turned = data.xmat[body].reshape(3, 3) @ z_onto(
            np.array(model.jnt_axis[joint], dtype=float)
        )
        # Several joints of one body turn one after another: the body's own turn belongs to the
        # last.
        frames.append(placed(turned, data.xanchor[joint]))
    return frames


def _link_bodies(model: Any, data: Any, chain: MjcfChain, carriers: list[Array]) -> list[Inertia]:
    """Return what each link weighs, in its frame."""
    parts: list[list[Inertia]] = [[] for _ in chain.joints]
    for body, link in chain.link_of.items():
        if model.body_mass[body] > 0.0:
            principal = np.diag(np.array(model.body_inertia[body], dtype=float))
            place = np.linalg.inv(carriers[link]) @ placed(data.ximat[body], data.xipos[body])
            with located(f"body {name_of(model, 'body', body)!r}: "):
                parts[link].append(
                    moved(Inertia(float(model.body_mass[body]), inertia=principal), place)
                )
    return [lumped(own) for own in parts]


def _effects(
    model: Any, data: Any, chain: MjcfChain, carriers: list[Array], names: list[str]
) -> list[dict[str, Any]]:
    """Return what MuJoCo adds to the rigid arm, as effects of the stated size."""
    flags = int(model.opt.disableflags)
    off = engine().mjtDisableBit
    found = []
    for name, joint in zip(names, chain.joints, strict=True):
        dof = int(model.jnt_dofadr[joint])
        adr = int(model.jnt_qposadr[joint])
        _, damping = motor_inertia_and_damping(model, joint)
        stiffness = float(model.jnt_stiffness[joint])
        loss = 0.0 if flags & off.mjDSBL_FRICTIONLOSS else float(model.dof_frictionloss[dof])
        dry, excess, speed = motor_friction(model, joint)
        spring = {"stiffness": stiffness, "rest": float(model.qpos_spring[adr])}
        stated: list[tuple[str, bool, dict[str, Any]]] = [
            (
                "viscous_friction",
                bool(damping) and not flags & off.mjDSBL_DAMPER,
                {"coefficient": damping},
            ),
            ("coulomb_friction", bool(loss + dry), {"torque": loss + dry}),
            ("stribeck_friction", bool(excess), {"torque": excess, "speed": speed}),
            ("joint_spring", bool(stiffness) and not flags & off.mjDSBL_SPRING, spring),
        ]
        found += [
            {"effect": effect, "joint": name, "parameters": p}
            for effect, there, p in stated
            if there
        ]
    for name, delay in zip(names, torque_delays(model, chain).tolist(), strict=True):
        late = {"delay": delay, "channels": ["motor_torque"]}
        found += [{"effect": "time_delay", "joint": name, "parameters": late}] if delay else []
    return [*found, *_compensation(model, data, chain, carriers, names)]


def _compensation(
    model: Any, data: Any, chain: MjcfChain, carriers: list[Array], names: list[str]
) -> list[dict[str, Any]]:
    """Return gravity compensation as an effect of each link; that which the actuators carry is part
    of their torque."""
    gains = np.array([float(model.body_gravcomp[body]) for body in chain.link_of])
    by_motor = [bool(model.jnt_actgravcomp[joint]) for joint in chain.joints]
    if not gains.any() or all(by_motor):
        return []
    if any(by_motor):
        raise RobotError(
            "gravity compensation acts through the actuators (actuatorgravcomp) at only"
            " some of the joints",
            "Set it for all joints of the chain, or for none",
        )
    found = []
    for i, name in enumerate(names):
        own = [body for body, link in chain.link_of.items() if link == i]
        masses = np.array(
            [model.body_gravcomp[body] * model.body_mass[body] for body in own], dtype=float
        )
        if not masses.sum():
            continue
        centres = np.array([np.linalg.inv(carriers[i]) @ [*data.xipos[body], 1.0] for body in own])[
            :, :3
        ]
        position = (masses @ centres / masses.sum()).tolist()
        parameters = {"mass": float(masses.sum()), "position": position}
        found.append({"effect": "carried_weight", "joint": name, "parameters": parameters})
    return found


def _notes(model: Any, chain: MjcfChain) -> list[str]:
    notes = [note for joint in chain.joints for note in left_out(model, joint)]
    for play, joint in chain.plays.items():
        name = name_of(model, "joint", joint)
        half = 0.5 * float(np.ptp(model.jnt_range[play]))
        notes.append(
            f"joint {name_of(model, 'joint', play)} is play of ±{half:g} rad in {name} and"
            " is fixed at its centre; in an arm file with elastic drives, it is"
            f" backlash:{name}:half_gap={half:g}"
        )
    if chain.held:
        names = ", ".join(name_of(model, "joint", joint) for joint in chain.held)
        notes.append(
            f"joints {names} are fixed, and their bodies are part of the link that carries them"
        )
    outside = set(range(1, model.nbody)) - set(chain.link_of)
    moving = [name_of(model, "joint", j) for body in outside for j in joints_of(model, body)]
    if moving:
        notes.append(f"joints {', '.join(moving)} are outside the chain and fixed")
    if float(model.opt.density) or float(model.opt.viscosity):
        notes.append("the fluid in MuJoCo's options (density, viscosity) is not part of the models")
    return notes
