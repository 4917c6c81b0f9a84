"""USD files: the arm that they were made of, as USD's own reader of physics finds it."""

import numpy as np
import pytest

from elastic_arm.errors import RobotError
from elastic_arm.mujoco import export_usd
from elastic_arm.robot import Inertia, JointController, load_robot
from elastic_arm.robot.kinematics import moved
from elastic_arm.robot.urdf_export import bodies_with_components
from tests.helpers.mujoco_arms import MODELS

pxr = pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Gf, Usd, UsdGeom, UsdPhysics  # noqa: E402

EFFECTS = (
    {"effect": "coulomb_friction", "joint": "joint2", "parameters": {"torque": 2.0}},
    {"effect": "viscous_friction", "joint": "joint2", "parameters": {"coefficient": 3.0}},
    {"effect": "joint_zero", "joint": "joint3", "parameters": {"offset": 0.1}},
    {"effect": "stribeck_friction", "joint": "joint2", "parameters": {"torque": 1.0, "speed": 0.1}},
)


def opened(robot, folder):
    done = export_usd(robot, None, folder / "arm.usda")
    return Usd.Stage.Open(str(folder / "arm.usda")), done


def test_numbers_of_joints_are_in_the_units_of_usd(tmp_path) -> None:
    """Armature, friction, damping, limits and gains, per degree where USD counts in degrees; what
    is left is named."""
    servo = JointController(kp=100.0, kd=5.0, torque=30.0)
    robot = (
        load_robot(MODELS / "arm.xml").with_(effects=EFFECTS).with_joint("joint2", controller=servo)
    )
    stage, done = opened(robot, tmp_path)
    (path,) = [p.GetPath() for p in stage.Traverse() if p.GetName() == "joint2"]
    prim, degree = stage.GetPrimAtPath(path), np.deg2rad(1.0)
    own = robot.joints[1]
    expected = {
        "newton:armature": own.armature,
        "newton:friction": 2.0,
        "newton:damping": 3.0 * degree,
        "physxJointAxis:angular:armature": own.armature,
        "physxJointAxis:angular:dynamicFrictionEffort": 2.0,
        "physxJointAxis:angular:viscousFrictionCoefficient": 3.0 * degree,
        "drive:angular:physics:stiffness": 100.0 * degree,
        "drive:angular:physics:damping": 5.0 * degree,
        "physics:lowerLimit": own.limits.position_min / degree,
    }
    assert {name: prim.GetAttribute(name).Get() for name in expected} == pytest.approx(
        expected, rel=1e-6
    )
    assert ("stribeck_friction", "joint2") in {(one.what, one.joint) for one in done.left}
    assert ("controller", "joint2") not in {(one.what, one.joint) for one in done.left}


@pytest.mark.parametrize("elastic", [False, True])
def test_usds_own_reader_finds_the_arm(tmp_path, elastic: bool) -> None:
    """Links have their masses and inertias about the world's axes; frames of a joint on both its
    links coincide."""
    robot = load_robot() if elastic else load_robot(MODELS / "arm.xml")
    stage, _ = opened(robot, tmp_path)
    found = UsdPhysics.UsdPhysicsLoadStageFromPrimRange(stage, ["/"])
    assert len(found[UsdPhysics.ObjectType.RevoluteJoint][1]) == robot.n
    assert len(found[UsdPhysics.ObjectType.Articulation][1]) == 1
    cache, place = UsdGeom.XformCache(), robot.base_placement
    for joint, body in zip(robot.joints, bodies_with_components(robot)[1:], strict=True):
        place = place @ joint.before @ joint.after
        (prim,) = [p for p in stage.Traverse() if p.GetName() == joint.link_name]
        mass, own = UsdPhysics.MassAPI(prim), moved(body, place)
        to_world = np.array(cache.GetLocalToWorldTransform(prim)).T
        axes = Gf.Matrix3d(Gf.Rotation(Gf.Quatd(mass.GetPrincipalAxesAttr().Get())))
        turn = to_world[:3, :3] @ np.array(axes).T
        inertia = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
        centre = to_world @ [*mass.GetCenterOfMassAttr().Get(), 1.0]
        assert mass.GetMassAttr().Get() == pytest.approx(body.mass, rel=1e-6)
        np.testing.assert_allclose(centre[:3], own.com, atol=1e-6)
        np.testing.assert_allclose(inertia, own.inertia, atol=1e-6 * np.abs(own.inertia).max())
    for path in found[UsdPhysics.ObjectType.RevoluteJoint][0]:
        joint, frames = UsdPhysics.Joint(stage.GetPrimAtPath(path)), []
        for k in (0, 1):
            (link,) = getattr(joint, f"GetBody{k}Rel")().GetTargets()
            pose = Gf.Matrix4d().SetRotate(getattr(joint, f"GetLocalRot{k}Attr")().Get())
            pose.SetTranslateOnly(Gf.Vec3d(getattr(joint, f"GetLocalPos{k}Attr")().Get()))
            frames.append(pose * cache.GetLocalToWorldTransform(stage.GetPrimAtPath(link)))
        np.testing.assert_allclose(*map(np.array, frames), atol=1e-6)


def test_a_base_without_mass_is_fixed_all_the_same(tmp_path) -> None:
    """A URDF often gives its first link no mass; what does not move may have any. A link without is
    refused."""
    robot = load_robot(MODELS / "arm.xml").with_(base_mass=0.0)
    stage, _ = opened(robot, tmp_path)
    (base,) = [p for p in stage.Traverse() if p.GetName() == "base"]
    assert UsdPhysics.MassAPI(base).GetMassAttr().Get() > 0.0
    light = Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    with pytest.raises(RobotError, match="no mass"):
        export_usd(robot.with_joint("joint3", link=light), None, tmp_path / "none.usda")
