"""The first arm of docs/first_arm.md, run as it stands there."""

import json
import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elastic_arm.identification import Identification
from elastic_arm.robot import load_robot
from tests.helpers import six_axes
from tests.helpers.pages import run_page

pytestmark = pytest.mark.slow(8)

ROOT = Path(__file__).parents[1]
MASS = 2.0
CENTRE = 0.15
INERTIA = 0.02
FRICTION = 0.3
GRAVITY = 9.81
URDF = f"""<robot name="arm">
<link name="base"/>
<joint name="shoulder" type="revolute">
  <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  <limit lower="-7" upper="7" effort="50" velocity="10"/>
</joint>
<link name="upper"><inertial>
  <origin xyz="0 0 {CENTRE}"/><mass value="{MASS}"/>
  <inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="0.003" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
</robot>"""


def table(seed: int) -> np.ndarray:
    """Return time, angle and torque of a pendulum with dry friction, 10 s at 100 Hz, with noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 10.0, 1 / 100)
    w = 2 * np.pi * 0.2 * np.arange(1, 5)[:, None]
    a, b = rng.normal(size=(2, 4, 1)) * 0.5 / np.arange(1, 5)[:, None]
    sin = np.sin(w * t)
    cos = np.cos(w * t)
    q, dq, ddq = (
        x.sum(axis=0)
        for x in (a * sin + b * cos, w * (a * cos - b * sin), -(w**2) * (a * sin + b * cos))
    )
    inertia = INERTIA + MASS * CENTRE**2
    weight = MASS * GRAVITY * CENTRE
    tau = inertia * ddq - weight * np.sin(q) + FRICTION * np.tanh(dq / 0.01)
    return np.column_stack(
        [t, q + 2e-5 * rng.normal(size=t.size), tau + 0.02 * rng.normal(size=t.size)]
    )


def written_tables(folder: Path, arm: str) -> None:
    """Write what a user has: the URDF and two tables."""
    n = len(six_axes.JOINTS)
    names = [
        f"{kind}_{i}" for kind in ("actual_q", "actual_qd", "actual_current") for i in range(n)
    ]
    own = {
        "six axes": (six_axes.urdf(), six_axes.table, ",".join(["time [s]", *names])),
        "one joint": (URDF, table, "time [s],shoulder position [rad],shoulder torque [Nm]"),
    }
    urdf, rows, header = own[arm]
    (folder / "arm.urdf").write_text(urdf)
    for run in (1, 2):
        path = folder / f"run_{run}.csv"
        np.savetxt(path, rows(run), "%.7g", ",", header=header, comments="")


def identified_by_the_page(folder: Path, arm: str) -> tuple[Identification, str]:
    """Run the page; return what is identified, after which nothing is left, and what is printed."""
    written_tables(folder, arm)
    printed = run_page((ROOT / "docs" / "first_arm.md").read_text(), folder)
    assert printed.count("no faults found") == 1
    found = json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
    assert (found["verdict"], found["causes"]) == ("none", [])
    return Identification.load(folder / "identified" / "identification.json"), printed


@pytest.fixture(scope="module")
def one_joint(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Identification]:
    """The folder in which the page was run for an arm of one joint, and what is identified."""
    folder = tmp_path_factory.mktemp("one_joint")
    return folder, identified_by_the_page(folder, "one joint")[0]


def test_the_commands_of_the_page_find_the_friction_of_a_joint(
    one_joint: tuple[Path, Identification],
) -> None:
    """The friction that the URDF lacks is identified, nothing is left then, and no tool is seen."""
    _, identified = one_joint
    (friction,) = (
        one for one in identified.estimates if one.name == "coulomb_friction:shoulder.torque"
    )
    assert friction.value == pytest.approx(FRICTION, abs=4 * friction.std)
    assert identified.carried is None


@pytest.mark.nightly
def test_the_commands_of_the_page_lead_to_what_the_urdf_lacks(tmp_path: Path) -> None:
    """Friction, motors' inertia and tool of six axes are identified, nothing is left then, and the
    function for a controller gives the torques of another motion."""
    identified, printed = identified_by_the_page(tmp_path, "six axes")
    estimates = {e.name: e for e in identified.estimates}
    for name, dry in zip(six_axes.JOINTS, six_axes.DRY, strict=True):
        assert estimates[f"coulomb_friction:{name}.torque"].value == pytest.approx(dry, rel=0.05)
    assert "wrist_3_link carries 1.2" in printed or "wrist_3_link carries 1.19" in printed
    assert identified.carried.mass == pytest.approx(six_axes.TOOL, rel=0.02)
    corrected = load_robot(tmp_path / "identified" / "arm_corrected.urdf")
    armatures = [joint.armature for joint in corrected.joints]
    # That of the first two joints and the inertia of their links are one number each.
    np.testing.assert_allclose(armatures[2:], six_axes.ARMATURES[2:], rtol=0.1)
    torque = runpy.run_path(str(tmp_path / "arm_torque.py"))["torque"]
    _, *motion = six_axes.motion(7)
    samples = [one[::100] for one in motion]
    made = np.array([torque(*sample) for sample in zip(*samples, strict=True)])
    true = six_axes.torques(*samples)
    # Dry friction turns over at other speeds in the function and on the arm.
    moving = np.abs(samples[1]) > 0.05
    miss = np.where(moving, made - true, 0.0)
    assert (np.abs(miss).max(axis=0) < 0.05 * np.abs(true).max(axis=0)).all()


def test_the_check_of_the_feed_forward_page_runs(
    one_joint: tuple[Path, Identification],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """What docs/feed_forward.md shows runs as it stands, and its numbers are those of a function
    that fits: far below the torques."""
    folder, _ = one_joint
    page = (ROOT / "docs" / "feed_forward.md").read_text()
    for name in ("arm_torque.py", "arm_torque.c"):
        (folder / name).unlink()
    run_page(page, folder)
    (example,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    made: dict[str, Any] = {}
    exec(compile(example, "feed_forward.md", "exec"), made)
    assert (made["miss"] < 0.3 * made["measured"].std(axis=0)).all()
    assert "error of the function" in capsys.readouterr().out


def test_one_step_from_the_urdf_finds_the_friction(
    one_joint: tuple[Path, Identification],
) -> None:
    """`diagnose` against the plain URDF names the friction as the cause, and then nothing is
    left."""
    folder, _ = one_joint
    commands = (
        "```sh\n"
        "elastic-arm diagnose run_1 --validate run_2 --robot arm.urdf --out plain\n"
        "elastic-arm diagnose run_2 --robot plain/robot.yaml --out again\n"
        "```"
    )
    run_page(commands, folder)
    assert (folder / "plain" / "arm_corrected.urdf").exists()
    found = json.loads((folder / "plain" / "diagnosis.json").read_text())
    (cause,) = found["causes"]
    assert (found["verdict"], cause["effect"], cause["joint"]) == (
        "explained",
        "coulomb_friction",
        "shoulder",
    )
    size = cause["parameters"]["torque"]
    assert size["value"] == pytest.approx(FRICTION, abs=4 * size["std"])
    assert json.loads((folder / "again" / "diagnosis.json").read_text())["verdict"] == "none"
