"""The bodies and joints of a compiled MuJoCo model that form the arm, and parts that a serial arm
cannot have.
"""

import difflib
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_arm.errors import RobotError
from elastic_arm.robot.mjcf.engine import engine
from elastic_arm.robot.urdf_tree import Chain

WORLD = 0


@dataclass(frozen=True)
class MjcfChain:
    """The arm in a compiled model, by the model's ids."""

    base: int  # body that the arm stands on
    joints: tuple[int, ...]  # hinges and slides from base to tip
    # by body, the index of the link that it is part of; bodies outside the arm are missing
    link_of: dict[int, int]
    # moving joints on the links that are no part of the chain, such as fingers
    held: tuple[int, ...]
    plays: Mapping[int, int]  # joint that is the play of another -> that one; held, too


def find_chain(model: Any, chain: Chain | None) -> MjcfChain:
    """Find the arm in a model."""
    base, tip = _only_chain(model) if chain is None else _named(model, chain)
    path = _path(model, base, tip)
    plays = {play: joint for body in path for play, joint in _plays(model, joints_of(model, body))}
    joints = [joint for body in path for joint in joints_of(model, body) if joint not in plays]
    if not joints:
        raise RobotError(
            "no joint moves between base and tip",
            "Give the bodies of base and tip: --chain base:tip",
        )
    for joint in joints:
        _require_axis(model, joint)
    last_joint = {}
    for body in path:
        own = [joint for joint in joints_of(model, body) if joint in joints]
        if own:
            last_joint[body] = joints.index(own[-1])
    link_of: dict[int, int] = {}
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        if body in last_joint:
            link_of[body] = last_joint[body]
        elif parent in link_of:
            link_of[body] = link_of[parent]
    held = tuple(
        j for body in link_of for j in joints_of(model, body) if j not in joints and j not in plays
    )
    found = MjcfChain(base, tuple(joints), link_of, held, plays)
    _refuse_couplings(model, found)
    _refuse_actuators(model, found)
    return found


def _plays(model: Any, joints: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield hinges that are the play of another on the same body and axis: limited more narrowly,
    else free.

    Of two joints about one axis one is no freedom of its own; this is how MuJoCo's models have
    backlash.
    """
    for joint, play in itertools.permutations(joints, 2):
        if slides(model, play) != slides(model, joint) or not model.jnt_limited[play]:
            continue
        axis = np.array(model.jnt_axis[play], dtype=float)
        other = np.array(model.jnt_axis[joint], dtype=float)
        apart = np.array(model.jnt_pos[play] - model.jnt_pos[joint], dtype=float)
        coaxial = np.allclose(np.cross(axis, other), 0.0) and np.allclose(
            np.cross(axis, apart), 0.0
        )
        width = [
            np.ptp(model.jnt_range[k]) if model.jnt_limited[k] else np.inf for k in (play, joint)
        ]
        driven = any(
            int(model.actuator_trnid[k, 0]) == play for k in range(len(model.actuator_trntype))
        )
        # A hinge that one without limits follows may be either.
        told = play > joint or model.jnt_limited[joint]
        if (
            coaxial
            and told
            and width[0] < width[1]
            and not driven
            and not model.jnt_stiffness[play]
        ):
            yield play, joint


def name_of(model: Any, kind: str, index: int) -> str:
    """Return the name of a body, joint, actuator …; one made of its number where it has none."""
    mj = engine()
    try:
        name = mj.mj_id2name(model, getattr(mj.mjtObj, f"mjOBJ_{kind.upper()}"), index)
    except UnicodeDecodeError:
        raise RobotError(f"the name of {kind} {index} is not valid UTF-8", "Rename it") from None
    return name or f"{kind}_{index}"


def joints_of(model: Any, body: int) -> list[int]:
    """Return the joints of a body."""
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def _named(model: Any, chain: Chain) -> tuple[int, int]:
    names = [name_of(model, "body", body) for body in range(model.nbody)]
    for end in chain:
        if end not in names:
            close = difflib.get_close_matches(end, names, n=3) or names[1:9]
            raise RobotError(
                f"chain {':'.join(chain)}: unknown body {end!r}",
                f"Give two bodies, such as {', '.join(close)}",
            )
    base, tip = (names.index(end) for end in chain)
    if base != tip and tip in _below(model, base):
        return base, tip
    raise RobotError(
        f"chain {':'.join(chain)}: {chain[1]!r} is not a descendant of {chain[0]!r}",
        "Give base and tip in this order",
    )


def _below(model: Any, body: int) -> set[int]:
    """Return a body and all that stand on it; parents come before their children."""
    found = {body}
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in found:
            found.add(other)
    return found


def _path(model: Any, base: int, tip: int) -> list[int]:
    """Return the bodies from base, which is left out, to tip."""
    path = []
    while tip != base:
        path.append(tip)
        tip = int(model.body_parentid[tip])
    return path[::-1]


def _only_chain(model: Any) -> tuple[int, int]:
    """Return base and tip of the chain that begins at the world."""
    fingers = set(_coupled(model))
    all_slides = {joint for joint in range(model.njnt) if slides(model, joint)}
    if len(fingers | all_slides) < model.njnt:
        fingers |= all_slides
    base = None
    tip = WORLD
    body = WORLD
    while True:
        moving = [child for child in _children(model, body) if _arm_joints(model, child, fingers)]
        if not moving:
            break
        if len(moving) > 1:
            names = ", ".join(name_of(model, "body", child) for child in moving)
            raise RobotError(
                f"the model branches at body {name_of(model, 'body', body)!r} into {names}",
                "Give the bodies of base and tip: --chain base:tip",
            )
        if joints_of(model, moving[0]):
            base = body if base is None else base
            tip = moving[0]
        body = moving[0]
    if base is None:
        raise RobotError(
            "the model contains no moving hinge or slide",
            "Give a model with a joint that no constraint couples",
        )
    return base, tip


def _children(model: Any, body: int) -> list[int]:
    return [child for child in range(1, model.nbody) if int(model.body_parentid[child]) == body]


def _arm_joints(model: Any, body: int, fingers: Collection[int]) -> list[int]:
    """Return the joints on a body, and on what it carries, that no finger has."""
    all_joints = [joint for below in _below(model, body) for joint in joints_of(model, below)]
    return [joint for joint in all_joints if joint not in fingers]


def _coupled(model: Any) -> Iterator[int]:
    """Yield joints that equality constraints couple to others."""
    joint_kind = int(engine().mjtEq.mjEQ_JOINT)
    for k in range(model.neq):
        if int(model.eq_type[k]) == joint_kind:
            yield from (int(j) for j in (model.eq_obj1id[k], model.eq_obj2id[k]) if j >= 0)


def slides(model: Any, joint: int) -> bool:
    """Return whether a joint is a slide."""
    return int(model.jnt_type[joint]) == int(engine().mjtJoint.mjJNT_SLIDE)


def _require_axis(model: Any, joint: int) -> None:
    mj = engine()
    kind = int(model.jnt_type[joint])
    if kind not in (int(mj.mjtJoint.mjJNT_HINGE), int(mj.mjtJoint.mjJNT_SLIDE)):
        what = "is a ball joint" if kind == int(mj.mjtJoint.mjJNT_BALL) else "is free"
        raise RobotError(
            f"joint {name_of(model, 'joint', joint)!r} {what}",
            "Only hinges and slides are supported: give a chain without it (--chain"
            " base:tip); joints outside are fixed at --at",
        )
    name = name_of(model, "joint", joint)
    dof = int(model.jnt_dofadr[joint])
    poly = {"damping": model.dof_dampingpoly[dof], "stiffness": model.jnt_stiffnesspoly[joint]}
    for term, coefficients in poly.items():
        if coefficients.any():
            raise RobotError(
                f"joint {name!r} has a {term} of higher order"
                f" ({', '.join(f'{c:g}' for c in coefficients)})",
                f"Only linear {term} is supported: omit the higher coefficients",
            )


def _refuse_couplings(model: Any, chain: MjcfChain) -> None:
    """Refuse tendons and equality constraints that act between links."""
    mj = engine()
    for k in range(model.neq):
        kind = int(model.eq_type[k])
        ends = (int(model.eq_obj1id[k]), int(model.eq_obj2id[k]))
        name = name_of(model, "equality", k)
        if kind == int(mj.mjtEq.mjEQ_JOINT):
            for joint in ends:
                if joint in chain.joints:
                    raise RobotError(
                        f"equality {name!r} couples joint {name_of(model, 'joint', joint)!r} to"
                        " another",
                        "Remove it, or give a chain without this joint (--chain base:tip)",
                    )
        elif kind in (int(mj.mjtEq.mjEQ_CONNECT), int(mj.mjtEq.mjEQ_WELD)):
            bodies: tuple[int, ...] = ends
            if int(model.eq_objtype[k]) == int(mj.mjtObj.mjOBJ_SITE):
                bodies = tuple(int(model.site_bodyid[site]) for site in ends)
            first, second = (chain.link_of.get(body) for body in bodies)
            if first != second:
                raise RobotError(
                    f"equality {name!r} closes a loop between bodies "
                    f"{' and '.join(repr(name_of(model, 'body', body)) for body in bodies)}",
                    "Only serial chains are supported: remove the constraint",
                )
    for tendon in range(model.ntendon):
        _refuse_tendon(model, chain, tendon)


def _refuse_tendon(model: Any, chain: MjcfChain, tendon: int) -> None:
    mj = engine()
    first = int(model.tendon_adr[tendon])
    links: set[int | None] = set()
    for wrap in range(first, first + int(model.tendon_num[tendon])):
        kind = int(model.wrap_type[wrap])
        obj = int(model.wrap_objid[wrap])
        if kind == int(mj.mjtWrap.mjWRAP_JOINT):
            if obj in chain.joints:
                links |= {-1, -2}
        elif kind == int(mj.mjtWrap.mjWRAP_SITE):
            links.add(chain.link_of.get(int(model.site_bodyid[obj])))
        elif kind in (int(mj.mjtWrap.mjWRAP_SPHERE), int(mj.mjtWrap.mjWRAP_CYLINDER)):
            links.add(chain.link_of.get(int(model.geom_bodyid[obj])))
    if len(links) > 1:
        raise RobotError(
            f"tendon {name_of(model, 'tendon', tendon)!r} acts on joints of the chain",
            "Tendon-driven arms are not supported: drive the joints, or give a chain without them",
        )


def _refuse_actuators(model: Any, chain: MjcfChain) -> None:
    """Refuse actuators whose torque at the chain's joints no formula of gain and bias gives."""
    mj = engine()
    on_joints = (int(mj.mjtTrn.mjTRN_JOINT), int(mj.mjtTrn.mjTRN_JOINTINPARENT))
    for k in range(len(model.actuator_trntype)):
        if (
            int(model.actuator_trntype[k]) not in on_joints
            or int(model.actuator_trnid[k, 0]) not in chain.joints
        ):
            continue
        name = name_of(model, "actuator", k)
        kinds = {
            "a muscle": (
                mj.mjtGain.mjGAIN_MUSCLE,
                mj.mjtBias.mjBIAS_MUSCLE,
                mj.mjtDyn.mjDYN_MUSCLE,
            ),
            "defined by callbacks": (
                mj.mjtGain.mjGAIN_USER,
                mj.mjtBias.mjBIAS_USER,
                mj.mjtDyn.mjDYN_USER,
            ),
        }
        found = (model.actuator_gaintype[k], model.actuator_biastype[k], model.actuator_dyntype[k])
        for what, values in kinds.items():
            if any(int(a) == int(b) for a, b in zip(found, values, strict=True)):
                raise RobotError(
                    f"actuator {name!r} is {what}: its torque is unknown",
                    "Drive the joint by a motor, position, velocity or general actuator",
                )
