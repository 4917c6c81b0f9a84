"""USD files for Isaac and Newton: rigid links, and joints with motor inertia, friction and drives.

UsdPhysics has neither armature nor friction. Engines have their own attributes for them, and all
are written: those of Newton and MuJoCo (`newton:`) and those of PhysX (`physxJointAxis:`). Angles
are in degrees, as usual in USD.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from elastic_arm.arrays import Array
from elastic_arm.effects import Catalogue, robot_effects
from elastic_arm.errors import require_libraries
from elastic_arm.mujoco.elements import servo
from elastic_arm.mujoco.left_out import left_effects, left_numbers
from elastic_arm.mujoco.mjcf_export import Exported
from elastic_arm.mujoco.stated_arm import StatedArm, StatedJoint, motor_inertia, stated_arm
from elastic_arm.output_files import write_result
from elastic_arm.robot import Inertia, Joint, JointController, Robot
from elastic_arm.robot.kinematics import link_radius
from elastic_arm.robot.parts import moved_joint, require
from elastic_arm.robot.urdf_elements import z_onto
from elastic_arm.robot.urdf_export import bodies_with_components

_REASON = "USD has no number for it"


def export_usd(
    robot: Robot, base: None, out: Path, *, catalogue: Catalogue | None = None
) -> Exported:
    """Write an arm as a new USD file (.usda), and list what it does not hold.

    Of an elastic arm the joints are rigid, with the motors' inertia. Raises a MissingExtraError if
    USD is not installed, and a RobotError if a link has no mass.
    """
    links = bodies_with_components(robot)[1:]
    rigid = robot.with_(
        joints=tuple(
            replace(joint, link=link, transmission=None, armature=motor_inertia(joint))
            for joint, link in zip(robot.joints, links, strict=True)
        )
    )
    stated = stated_arm(rigid, catalogue)
    springs = [one for one in robot_effects(rigid, catalogue) if one.effect.id == "joint_spring"]
    effects = [*stated.left, *((one, _REASON) for one in (*springs, *stated.delays))]
    others = [replace(joint, controller=None) if _drive(joint) else joint for joint in robot.joints]
    numbers = left_numbers(robot.with_(joints=tuple(others)), _REASON, elasticity=True)
    write_result(out, _stage(rigid, stated))
    return Exported(
        (out,), (), (*left_effects(rigid, effects, catalogue), *numbers), units=robot.units
    )


def _drive(joint: Joint) -> JointController | None:
    """Return a joint's controller where it is what a drive of UsdPhysics is: a servo that is not
    late."""
    own = servo(joint.controller)
    return None if own is None or own.delay or own != joint.controller else own


def _stage(robot: Robot, stated: StatedArm) -> str:
    require_libraries("USD files need", "usd-core:pxr")
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    scene = UsdPhysics.Scene.Define(stage, "/physics")
    size = float(np.linalg.norm(stated.gravity))
    scene.CreateGravityMagnitudeAttr(size)
    scene.CreateGravityDirectionAttr(Gf.Vec3f(*(stated.gravity / (size or 1.0)).tolist()))
    root = UsdGeom.Xform.Define(stage, f"/{_name(robot.name)}").GetPrim()
    stage.SetDefaultPrim(root)
    UsdPhysics.ArticulationRootAPI.Apply(root)
    place = robot.base_placement
    paths = []
    for i, (name, body) in enumerate(
        zip(("base", *robot.link_names), _bodies(robot, stated), strict=True)
    ):
        if i:
            place = place @ _start(robot, stated, i - 1) @ robot.joints[i - 1].after
        link = UsdGeom.Xform.Define(stage, f"{root.GetPath()}/{_name(name)}")
        link.AddTranslateOp().Set(Gf.Vec3d(*place[:3, 3].tolist()))
        link.AddOrientOp().Set(_turned(place))
        UsdPhysics.RigidBodyAPI.Apply(link.GetPrim())
        _mass(link.GetPrim(), name, body)
        ends = [np.linalg.inv(robot.joints[i - 1].after)[:3, 3]] if i else [np.zeros(3)]
        ends.append(robot.joints[i].before[:3, 3] if i < robot.n else np.zeros(3))
        _capsule(stage, f"{link.GetPath()}/shape", ends[0], ends[1], link_radius(robot))
        paths.append(link.GetPath())
    fixed = UsdPhysics.FixedJoint.Define(stage, f"{root.GetPath()}/base_fixed")
    fixed.CreateBody1Rel().SetTargets([paths[0]])
    _frame(fixed, 0, robot.base_placement)
    for i, joint in enumerate(robot.joints):
        made = UsdPhysics.PrismaticJoint if joint.prismatic else UsdPhysics.RevoluteJoint
        own = made.Define(stage, f"{root.GetPath()}/{_name(joint.name)}")
        own.CreateBody0Rel().SetTargets([paths[i]])
        own.CreateBody1Rel().SetTargets([paths[i + 1]])
        own.CreateAxisAttr("Z")
        _frame(own, 0, _start(robot, stated, i))
        _frame(own, 1, np.linalg.inv(joint.after))
        _numbers(own, joint, stated.joints[i])
    return str(stage.GetRootLayer().ExportToString())


def _bodies(robot: Robot, stated: StatedArm) -> list[Inertia]:
    base = bodies_with_components(robot)[0]
    if not base.mass:
        # it is fixed, so that any mass will do, but USD wants one
        base = Inertia(1.0, np.zeros(3), np.eye(3))
    return [base, *stated.links]


def _start(robot: Robot, stated: StatedArm, i: int) -> Array:
    """Return where joint i stands on the link before it when it reads zero."""
    joint = robot.joints[i]
    return joint.before @ moved_joint(-stated.joints[i].zero, joint.prismatic)


def _numbers(made: Any, joint: Joint, numbers: StatedJoint) -> None:
    """State limits, inertia and friction of a joint, and its drive."""
    from pxr import Sdf, UsdPhysics

    kind = "linear" if joint.prismatic else "angular"
    # degrees in what the arm counts angles by
    turn = 1.0 if joint.prismatic else float(np.rad2deg(1.0))
    prim = made.GetPrim()
    limits = joint.limits
    own = f"physxJointAxis:{kind}:"
    if limits.position_min is not None and limits.position_max is not None:
        made.CreateLowerLimitAttr(turn * limits.position_min)
        made.CreateUpperLimitAttr(turn * limits.position_max)
    viscous = numbers.damping / turn
    dry = numbers.friction_loss
    values = {
        "newton:armature": numbers.armature,
        "newton:damping": viscous,
        "newton:friction": dry,
    }
    values |= {f"{own}armature": numbers.armature, f"{own}viscousFrictionCoefficient": viscous}
    values |= {f"{own}staticFrictionEffort": dry, f"{own}dynamicFrictionEffort": dry}
    if limits.velocity is not None:
        values |= {
            "newton:velocityLimit": turn * limits.velocity,
            f"{own}maxJointVelocity": turn * limits.velocity,
        }
    for schema in ("NewtonJointAPI", f"PhysxJointAxisAPI:{kind}"):
        prim.AddAppliedSchema(schema)
    for name, value in values.items():
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, custom=False).Set(value)
    drive = UsdPhysics.DriveAPI.Apply(prim, kind)
    controller = _drive(joint)
    drive.CreateTypeAttr("force")
    drive.CreateStiffnessAttr(controller.kp / turn if controller else 0.0)
    drive.CreateDampingAttr(controller.kd / turn if controller else 0.0)
    torques = [
        one for one in (limits.torque, controller.torque if controller else None) if one is not None
    ]
    if torques:
        drive.CreateMaxForceAttr(min(torques))


def _mass(prim: Any, name: str, body: Inertia) -> None:
    from pxr import Gf, UsdPhysics

    require(
        body.mass > 0.0,
        f"{name} has no mass, which USD requires",
        "Give it a mass in the description",
    )
    moments, axes = np.linalg.eigh(body.inertia)
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(body.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*body.com.tolist()))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    mass.CreatePrincipalAxesAttr(_turned(axes * np.linalg.det(axes)))


def _capsule(stage: Any, path: str, start: Array, end: Array, radius: float) -> None:
    """Draw a link from joint to joint; for the eye, not for collisions."""
    from pxr import Gf, UsdGeom

    along = end - start
    length = float(np.linalg.norm(end - start))
    if length <= 1e-6:  # m, as in the URDF
        return
    shape = UsdGeom.Capsule.Define(stage, path)
    shape.CreateAxisAttr("Z")
    shape.CreateRadiusAttr(0.7 * radius)
    shape.CreateHeightAttr(length)
    shape.AddTranslateOp().Set(Gf.Vec3d(*(0.5 * (start + end)).tolist()))
    shape.AddOrientOp().Set(_turned(z_onto(along / length)))


def _frame(joint: Any, body: int, placement: Array) -> None:
    from pxr import Gf

    getattr(joint, f"CreateLocalPos{body}Attr")(Gf.Vec3f(*placement[:3, 3].tolist()))
    getattr(joint, f"CreateLocalRot{body}Attr")(_turned(placement))


def _turned(rotation: Array) -> Any:
    """Return the rotation of a rotation, or of a placement, as a quaternion of USD."""
    from pxr import Gf

    # as in recording/writing.py
    x, y, z, w = Rotation.from_matrix(rotation[:3, :3].copy()).as_quat().tolist()
    return Gf.Quatf(w, x, y, z)


def _name(name: str) -> str:
    from pxr import Tf

    return str(Tf.MakeValidIdentifier(name))
