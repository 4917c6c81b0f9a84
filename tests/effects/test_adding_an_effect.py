"""The page docs/adding_an_effect.md, run as a new user would."""

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from elastic_arm.app import app
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.effects import Catalogue
from elastic_arm.recording import read_recording
from elastic_arm.robot import load_robot

PAGE = (Path(__file__).parents[2] / "docs" / "adding_an_effect.md").read_text(encoding="utf-8")


def commands(section: str) -> list[list[str]]:
    """Return the arguments of the commands of one section of the page."""
    text = PAGE[PAGE.index(section) + 3 :].split("\n## ", 1)[0].replace("\\\n", "")
    return [
        shlex.split(line)[1:] for line in re.findall(r"^    (elastic-arm .+)$", text, re.MULTILINE)
    ]


def run(arguments: list[str]) -> str:
    """Run a command of the application."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, f"{arguments}: {result.output}"
    return result.output


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the page's file."""
    (code,) = re.findall(r"```python\n(.+?)```", PAGE, re.DOTALL)
    (tmp_path / "rubber_buffer.py").write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_pages_effect_is_simulated_and_found(folder: Path) -> None:
    """The page's recordings, shorter, hold the buffer: among few candidates it is found with its
    stiffness and contact angle."""
    for arguments in commands("## 2."):
        run([*arguments, "--duration", "10", "--rate", "250"])
    catalogue = Catalogue.default().with_files([folder / "rubber_buffer.py"])
    few = tuple(catalogue[name] for name in ("rubber_buffer", "coulomb_friction"))
    fitted, judge = (read_recording(folder / name) for name in ("buffer", "judge"))
    found = diagnose([fitted], Question(load_robot(), effects=few), [judge])
    assert found.verdict == "explained"
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("rubber_buffer", "joint_2")
    assert cause.parameters["stiffness"].value == pytest.approx(60.0, rel=0.05)
    assert cause.parameters["contact"].value == pytest.approx(0.4, abs=0.05)


@pytest.mark.nightly
@pytest.mark.slow
def test_the_pages_effect_is_simulated_and_named_blindly(folder: Path) -> None:
    """The recordings that the page makes are diagnosed as the buffer on its joint, with stiffness
    and contact angle."""
    for arguments in [*commands("## 2."), *commands("## 3.")]:
        run(arguments)
    found = json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
    assert found["verdict"] == "explained"
    cause = found["causes"][0]
    assert (cause["effect"], cause["joint"]) == ("rubber_buffer", "joint_2")
    assert cause["parameters"]["stiffness"]["value"] == pytest.approx(60.0, rel=0.05)
    assert cause["parameters"]["contact"]["value"] == pytest.approx(0.4, abs=0.05)


@pytest.mark.nightly
@pytest.mark.slow
def test_the_pages_effect_is_drawn_in_a_challenge(folder: Path) -> None:
    """The challenge draws, records and names the buffer, and states that the suite's own simulator
    moved the arm."""
    create, diagnose, score = commands("## 4.")
    output = run([*create, "--workers", "1", "--seconds", "6", "--validate-seconds", "5"])
    assert "rubber_buffer" in output and "own simulator" in " ".join(output.split())
    run([*diagnose, "--workers", "1"])
    run(score)
    found = json.loads((folder / "blind" / "score.json").read_text())
    assert found["simulated"] == ["rubber_buffer"]
    (line,) = (x for x in found["items"] if x["truth"])
    assert line["effect_right"] and line["named"][0] == "rubber_buffer"
