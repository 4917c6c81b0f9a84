"""A single linear drive, from an amplifier's log to parameters and verdict, with the units of a
linear axis."""

import json
from pathlib import Path

import pytest

from tests.helpers import command_line
from tests.helpers.linear_axis import COULOMB, MASS, OFFSET, VISCOUS, write_axis


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of one axis as bags, and its description, 15 % lighter than it is."""
    folder = tmp_path_factory.mktemp("axis")
    write_axis(folder)
    for name in ("fit", "judge"):
        run(
            "bag",
            "import",
            folder / f"{name}.mat",
            "--map",
            folder / "map.yaml",
            "--out",
            folder / name,
        )
    return folder


def run(*words: object) -> str:
    found = command_line.run(*words)
    assert found.exit_code == 0, found.output
    return found.output


def test_mass_and_friction_of_a_linear_axis_are_identified(folder: Path) -> None:
    """Mass, friction and offset come out within 1 % (0.1 N), in kg, N s/m and N."""
    laws = [
        word
        for law in ("coulomb_friction", "viscous_friction", "motor_torque_offset")
        for word in ("--with", law)
    ]
    told = run(
        "identify",
        folder / "fit",
        "--robot",
        folder / "axis.yaml",
        *laws,
        "--out",
        folder / "identified",
    )
    assert "residual of the fit, N\n" in told
    found = json.loads((folder / "identified" / "identification.json").read_text())
    estimates = {e["name"].rpartition(".")[2]: (e["value"], e["unit"]) for e in found["estimates"]}
    assert estimates == {
        "m": (pytest.approx(MASS, rel=0.01), "kg"),
        "torque": (pytest.approx(COULOMB, rel=0.01), "N"),
        "coefficient": (pytest.approx(VISCOUS, rel=0.01), "N s/m"),
        "offset": (pytest.approx(OFFSET, abs=0.1), "N"),
    }


@pytest.mark.nightly
def test_friction_of_a_linear_axis_is_diagnosed(folder: Path) -> None:
    """Coulomb and viscous friction, a zero and the mass, or what it cannot be told from, are the
    causes, no bent law in their place; sizes are within their deviations, which the gain that
    scales them all makes large."""
    told = run(
        "diagnose", folder / "fit", "--validate", folder / "judge", "--robot", folder / "axis.yaml",
        "--refit", "--out", folder / "diagnosed",
    )  # fmt: skip
    assert "residuals in N below" in told and "Nm" not in told
    found = json.loads((folder / "diagnosed" / "diagnosis.json").read_text())
    causes = {c["effect"]: c for c in found["causes"]}
    frictions = {
        "coulomb_friction": ("torque", COULOMB, "N"),
        "viscous_friction": ("coefficient", VISCOUS, "N s/m"),
    }
    others = {
        "motor_torque_offset",
        "base_tilt",
        "link_inertia_mismatch",
        "motor_torque_gain",
        "payload",
    }
    assert set(frictions) <= set(causes) <= {*frictions, *others}
    for effect, (name, true, unit) in frictions.items():
        size = causes[effect]["parameters"][name]
        assert abs(size["value"] - true) < 2.0 * size["std"] < 0.2 * true and size["unit"] == unit
        assert causes[effect]["confidence"] > 0.9


def test_a_simulated_axis_has_forces_and_lengths(folder: Path) -> None:
    """What is printed of a simulation, and of a file that does not hold an effect."""
    axis = folder / "axis.yaml"
    words = (
        "--effect",
        "motor_torque_offset:axis:offset=3",
        "--duration",
        "0.5",
        "--out",
        folder / "simulated",
    )
    told = run("simulate", "--robot", axis, *words)
    assert (
        "peak tau_m, N " in told
        and "tracking error, mm" in told
        and "offset 3 N" in told
        and "Nm" not in told
    )
    (folder / "loaded.yaml").write_text(
        axis.read_text()
        + "effects: [{effect: motor_torque_offset, joint: axis, parameters: {offset: -0.432}}]\n"
    )
    left = run("export", folder / "loaded.yaml", "--to", "urdf", "--out", folder / "loaded.urdf")
    assert "motor_torque_offset on axis (offset -0.432 N)" in left
