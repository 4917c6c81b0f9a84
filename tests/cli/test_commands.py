"""The command line: what it writes, what it never overwrites, and words a user can act on."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.table import Table
from typer.testing import CliRunner

from elastic_arm.app import SUBCOMMANDS, app, load
from elastic_arm.cli.console import UNLIMITED, PipeConsole
from elastic_arm.excitation import load_trajectory
from elastic_arm.recording import write_recording
from elastic_arm.robot import load_robot, save_robot, to_urdf
from elastic_arm.robot.loading import NOMINAL_ARM
from tests.helpers.bags import two_sided
from tests.helpers.command_line import refusal, run
from tests.helpers.motions import trajectory


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "bag", two_sided(np.random.default_rng(0), 300))


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    trajectory(n=3, period=1.0, ramp=0.2, periods=1).scaled(0.01).save(tmp_path / "motion.yaml")
    return tmp_path / "motion.yaml"


# --- what the commands write


def test_excite_writes_a_trajectory_and_says_what_it_reached(tmp_path: Path) -> None:
    """`elastic-arm excite` writes a file that loads, and JSON with the criterion before and
    after."""
    file = tmp_path / "t.yaml"
    further = ("--csv", tmp_path / "traj.csv", "--goal", tmp_path / "goal.yaml")
    search = ("--evaluations", 30, "--harmonics", 3)
    result = run("excite", "--out", file, *search, "--json", *further)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["criterion"] == "a_optimal" and told["value"]["after"] <= told["value"]["before"]
    assert load_trajectory(file).joints == ("joint_1", "joint_2", "joint_3")
    assert told["excitation"]["poor"] is False and told["excitation"]["reasons"] == []
    assert load_trajectory(file).duration == pytest.approx(
        5.0 + 10.0 * told["excitation"]["periods"]
    )
    assert (tmp_path / "traj.csv").exists() and (tmp_path / "goal.yaml").exists()


def test_describe_tells_joints_and_base_parameters() -> None:
    """`elastic-arm describe --json` gives the arm file's content, mass and named base
    parameters."""
    told = json.loads(run("describe", "--json").stdout)
    assert told["mass_kg"] == pytest.approx(139.0)
    assert [joint["name"] for joint in told["robot"]["joints"]] == ["joint_1", "joint_2", "joint_3"]
    assert len(told["base_parameters"]) == 26
    assert "joint_3.K [Nm/rad]" in run("describe", "--base").stdout
    assert "parameters of mod3, the base" in " ".join(run("describe").stdout.split())


def test_a_rigid_arm_is_described_without_a_model(tmp_path: Path) -> None:
    """The parameters of a URDF, and of an arm file with armatures, are those of links: mod3 is not
    mentioned."""
    urdf = tmp_path / "arm.urdf"
    rigid = tmp_path / "rigid.yaml"
    urdf.write_text(to_urdf(load_robot()))
    joints = tuple(replace(joint, transmission=None, armature=0.1) for joint in load_robot().joints)
    save_robot(load_robot().with_(joints=joints), rigid)
    for file in (urdf, rigid):
        told = run("describe", "--robot", file).stdout
        assert "mod3" not in told
        assert re.search(r"motion determines \d+ combinations of", " ".join(told.split()))


def test_a_servo_is_described_with_its_electrics(tmp_path: Path) -> None:
    """Gains alone do not describe a servo: torque of full duty, supply, its sag, and the register
    for which they hold; a plain controller has none of them."""
    motor = {"supply": 7.5, "torque_per_volt": 0.1, "back_emf": 0.4, "duty_per_rad": 0.2}
    plain = {"kp": 4.0, "kd": 0.1}
    servo = {"motor": motor, "sag": 0.25, "dead_band": 0.003, "firmware_gain": 400}
    controllers = {"joint_1": servo, "joint_2": plain}
    joints = tuple(replace(joint, transmission=None) for joint in load_robot().joints)
    save_robot(load_robot().with_(joints=joints), tmp_path / "arm.yaml")
    content = yaml.safe_load((tmp_path / "arm.yaml").read_text()) | {"controller": controllers}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(content))
    told = run("describe", "--robot", tmp_path / "arm.yaml").stdout.splitlines()
    (first,) = [line for line in told if "controller of joint_1" in line]
    (second,) = [line for line in told if "controller of joint_2" in line]
    for words in ("stall torque 0.75 Nm", "supply 7.5 V", "sag of the supply 0.25"):
        assert words in first and words not in second
    assert "dead band 0.003 rad" in first and "gain register 400" in first
    assert "kp 0.15 Nm/rad" in first  # supply, torque per volt and duty per rad


def test_a_urdf_that_is_written_has_the_armature(tmp_path: Path) -> None:
    """As Drake's tags of a rigid arm, and of an elastic one as the inertia of its motors; the
    springs are listed as left out."""
    joints = tuple(
        replace(joint, transmission=None, armature=0.1 * k)
        for k, joint in enumerate(load_robot().joints, start=1)
    )
    save_robot(load_robot().with_(joints=joints), tmp_path / "rigid.yaml")
    done = run("describe", "--robot", tmp_path / "rigid.yaml", "--urdf", tmp_path / "rigid.urdf")
    assert "not in the file" not in done.stdout
    read = load_robot(tmp_path / "rigid.urdf")
    assert [joint.armature for joint in read.joints] == pytest.approx([0.1, 0.2, 0.3])
    done = run("describe", "--urdf", tmp_path / "elastic.urdf")
    assert "not in the file: drive on joint_1 (stiffness" in " ".join(done.stdout.split())
    elastic = load_robot(tmp_path / "elastic.urdf").joints
    rotor = load_robot().joints[0].transmission
    assert rotor is not None and elastic[0].armature == pytest.approx(176.5, rel=1e-3)


# --- nothing is overwritten unasked


KEPT: dict[
    str, tuple[str, list[object], str]
] = {  # what is there, and what the refusal to overwrite it names
    "describe": ("arm.urdf", ["--urdf", "{}/arm.urdf"], "already exists"),
    "excite": ("motion.yaml", ["--out", "{}/motion.yaml"], "already exists"),
    "identify": ("robot.yaml", ["bags/excitation", "--out", "{}"], "robot.yaml"),
    "diagnose": ("report.html", ["bags/excitation", "--out", "{}"], "report.html"),
    "paper": ("claims.csv", ["--out", "{}"], "claims.csv"),
}


@pytest.mark.parametrize("command", KEPT)
def test_nothing_is_overwritten_unasked(tmp_path: Path, command: str) -> None:
    """Before the work a command refuses to write over a file, in a folder or by its name, and
    leaves it as it is."""
    name, arguments, words = KEPT[command]
    (tmp_path / name).write_text("mine")
    said = refusal(command, *(str(word).format(tmp_path) for word in arguments))
    assert words in said and "--force" in said
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_a_file_is_overwritten_with_force(tmp_path: Path) -> None:
    """`describe --urdf --force` writes where something stands."""
    (tmp_path / "arm.urdf").write_text("mine")
    assert run("describe", "--urdf", tmp_path / "arm.urdf", "--force").exit_code == 0
    assert (tmp_path / "arm.urdf").read_text().startswith("<?xml")


def test_no_recording_is_overwritten(tmp_path: Path, bag: Path, motion: Path) -> None:
    """`simulate` and `bag import` refuse a bag that exists; there is no force."""
    assert "recordings are never overwritten" in refusal(
        "simulate", "--trajectory", motion, "--out", bag
    )
    np.savez(tmp_path / "a.npz", t=np.arange(3.0))
    (tmp_path / "map.yaml").write_text("joints: [a]\ntimes: {key: t}\nlink: {position: {key: t}}\n")
    said = refusal(
        "bag", "import", tmp_path / "a.npz", "--map", tmp_path / "map.yaml", "--out", bag
    )
    assert "recordings are never overwritten" in said


COMMANDS: dict[str, list[object]] = {
    "excite": ["excite", "--out"],
    "simulate": ["simulate", "--trajectory", "default", "--out"],
    "identify": ["identify", "BAG", "--out"],
    "describe": ["describe", "--urdf"],
    "paper": ["paper", "--out"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_place_that_cannot_be_written_is_found_before_the_work(
    tmp_path: Path, bag: Path, command: str
) -> None:
    """Where a file stands in the way of the folder, every command says so at once, and leaves no
    trace."""
    (tmp_path / "file").write_text("mine")
    there = sorted(tmp_path.rglob("*"))
    arguments = [bag if word == "BAG" else word for word in COMMANDS[command]]
    said = refusal(*arguments, tmp_path / "file" / "sub" / "result")
    assert f"{tmp_path / 'file'} is a file, not a folder" in said
    assert sorted(tmp_path.rglob("*")) == there


def test_a_challenge_needs_a_folder_not_a_file(tmp_path: Path) -> None:
    """`challenge create FILE` is refused in words before anything is drawn."""
    (tmp_path / "file").write_text("mine")
    said = refusal("challenge", "create", tmp_path / "file")
    assert f"{tmp_path / 'file'} is a file, not a folder. Choose another path for FOLDER." in said


# --- words for what makes no sense


USAGE: dict[str, tuple[str, str]] = {
    "diagnose --nope bag": ("no such option: --nope", "diagnose"),
    "diagnose": ("missing argument 'BAG…'", "diagnose"),
    "simulate --out": ("option '--out' requires an argument", "simulate"),
    "identify bag --clock beauty": ("'beauty' is not one of", "identify"),
    "excite --seed one --out t": ("invalid value for '--seed'", "excite"),
    "bag chek": ("no such command 'chek'. Did you mean 'check'?", "bag"),
    "bag check": ("missing argument", "bag check"),
    "bag import a --map m --out b --compression zip": ("one of none, lz4, zstd", "bag import"),
    "challenge create folder --ratio 3": (
        "invalid value for --ratio: '3' is not a range",
        "challenge create",
    ),
}


@pytest.mark.parametrize("arguments", USAGE)
def test_usage_errors_are_one_line_with_the_help_to_read(arguments: str) -> None:
    """Unknown options, missing arguments and wrong values of every command end as all unusable
    input does."""
    words, command = USAGE[arguments]
    said = refusal(*arguments.split())
    assert words in said
    assert said.endswith(f" See elastic-arm {command} --help.")


def test_an_unknown_command_is_one_line() -> None:
    """`elastic-arm foo` points at the help of the application."""
    assert refusal("foo") == "error: no such command 'foo'. See elastic-arm --help."


@pytest.mark.parametrize("arguments", ["--help", "bag --help", "diagnose --help", "--version"])
def test_help_and_version_end_with_0(arguments: str) -> None:
    """What was asked for is no error, and goes to stdout."""
    result = run(*arguments.split())
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.strip()


def test_without_arguments_four_ways_in_are_shown() -> None:
    """`elastic-arm` alone shows commands for a start, each with options that it has; a group shows
    its help."""
    result = run()
    assert (result.exit_code, result.stderr) == (2, "")
    shown = re.findall(r"elastic-arm (\w.*)", result.stdout)
    assert [line.split()[0] for line in shown] == ["simulate", "identify", "diagnose", "bag"]
    for line in shown:
        words = line.split()
        told = run(*words[: 2 if words[0] == "bag" else 1], "--help")
        assert told.exit_code == 0
        assert all(word in told.stdout for word in words if word.startswith("--"))
    assert "Usage: " in run("bag").stdout


UNUSABLE: dict[str, str] = {  # a command but for --out -> what its refusal names
    "simulate --duration 1e9": "samples",
    "simulate --rate 1e9 --duration 1": "samples",
    "simulate --duration 0": "duration",
    "simulate --substeps 3": "even",
    "simulate --model mod4": "mod4",
    "simulate --sensors perfect": "exact",
    "simulate --trajectory nowhere.yaml": "nowhere.yaml",
    "simulate --effect friction:joint_1:torque=1": "Did you mean",
    "simulate --effect payload:mass=-5": "at least 0 kg",
    "excite --harmonics 0": "harmonics",
    "excite --harmonics 100000": "harmonics",
    "excite --criterion beauty": "beauty",
    "excite --robot none.yaml": "none.yaml",
    "excite --torque -3": "torque",
    "excite --margin -1": "margin",
    "excite --floor nan": "nan",
    "excite --ramp 1e9": "",
    "excite --ramp nan": "ramp",
}


@pytest.mark.parametrize("command", UNUSABLE)
def test_what_makes_no_sense_is_refused_and_nothing_is_begun(tmp_path: Path, command: str) -> None:
    """Unusable options, sizes that no arm has and recordings that no memory holds: one line, status
    2, no file."""
    assert UNUSABLE[command] in refusal(*command.split(), "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


EFFECTS_OF_FILES = {
    "unknown effect 'columb_fr": {"effect": "columb_friction"},
    "coulomb_friction lacks its parameter torque": {
        "effect": "coulomb_friction",
        "joint": "joint_1",
    },
}


@pytest.mark.parametrize("words", EFFECTS_OF_FILES)
def test_a_wrong_effect_of_an_arm_file_is_said_with_the_file(tmp_path: Path, words: str) -> None:
    """A misspelt effect, and one without a size."""
    content = {**yaml.safe_load(NOMINAL_ARM.read_text()), "effects": [EFFECTS_OF_FILES[words]]}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(content))
    assert f"{tmp_path / 'arm.yaml'}: {words}" in refusal(
        "describe", "--robot", tmp_path / "arm.yaml"
    )


def test_true_and_nominal_arm_must_have_the_same_joints(tmp_path: Path, motion: Path) -> None:
    """`simulate --nominal` with another number of joints names both arms and numbers."""
    arm = load_robot()
    short = yaml.safe_load(NOMINAL_ARM.read_text())
    short["joints"] = short["joints"][:2]
    (tmp_path / "two.yaml").write_text(yaml.safe_dump(short))
    said = refusal(
        "simulate",
        "--trajectory",
        motion,
        "--nominal",
        tmp_path / "two.yaml",
        "--out",
        tmp_path / "new",
    )
    assert f"{arm.name} has 3 joints, the nominal arm {arm.name} has 2" in said


def test_missing_channel_maps_and_arrays_are_said_without_numbers_of_the_system(
    tmp_path: Path, bag: Path
) -> None:
    """No such file is no such file, for maps and arrays too."""
    assert "no such file" in refusal("bag", "info", bag, "--channels", tmp_path / "none.yaml")
    assert refusal("replay", bag, "--robot", tmp_path / "none.xml").count("none.xml") == 1
    (tmp_path / "map.yaml").write_text(
        "joints: [a]\ntimes: {rate: 100}\nlink: {position: {key: t}}\n"
    )
    said = refusal(
        "bag",
        "import",
        tmp_path / "none.npz",
        "--map",
        tmp_path / "map.yaml",
        "--out",
        tmp_path / "i",
    )
    assert "No such file" in said


def test_summaries_are_the_first_sentences_of_the_subcommands() -> None:
    """What the help of the application shows of a subcommand is what the subcommand itself begins
    with."""
    for name, subcommand in SUBCOMMANDS.items():
        first = str(load(name).help).split("\n\n")[0]
        assert " ".join(first.split()) == subcommand.summary


SPARED = {  # command -> what it shows, and what it does not import
    "--help": ("Usage", ("numpy", "casadi", "scipy", "matplotlib", "cvxpy", "rosbags", "pydantic")),
    "describe --base": (
        "base parameters",
        ("scipy.optimize", "cvxpy", "rosbags", "mcap", "elastic_arm.effects"),
    ),
}


@pytest.mark.parametrize("command", SPARED)
def test_commands_import_no_library_that_they_do_not_need(command: str) -> None:
    """The help needs neither NumPy nor CasADi, a description neither estimators nor readers of
    bags."""
    shown, heavy = SPARED[command]
    lines = (
        "import sys",
        "from typer.testing import CliRunner",
        "from elastic_arm.app import app",
        f"assert {shown!r} in CliRunner().invoke(app, {command.split()!r}).output",
        f"sys.exit(' '.join(name for name in {heavy!r} if name in sys.modules) or None)",
    )
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_a_table_in_a_pipe_is_not_padded(capsys: pytest.CaptureFixture[str]) -> None:
    """In a pipe a row ends with its last word, however wide another row is, and no word is cut."""
    table = Table("number", "name", box=None)
    table.add_row("1", "a")
    table.add_row("2", "b" * 400)
    PipeConsole(width=UNLIMITED).print(table)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3 and lines == [line.rstrip() for line in lines]
    assert lines[2].endswith("b" * 400)


@pytest.mark.parametrize(
    ("written", "offered"),
    [
        ("coul", ["coulomb_friction"]),
        (
            "coulomb_friction:",
            ["coulomb_friction:joint_1", "coulomb_friction:joint_2", "coulomb_friction:joint_3"],
        ),
        ("hysteresis:joint_1:torque=5,w", ["hysteresis:joint_1:torque=5,width="]),
        ("nonsense:joint_1:", []),
    ],
)
def test_shells_complete_effects_joints_and_parameters(written: str, offered: list[str]) -> None:
    """`elastic-arm simulate --effect TAB` offers the catalogue, behind a colon the arm's joints,
    then the numbers."""
    environment = {
        "_ELASTIC_ARM_COMPLETE": "complete_fish",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    environment["_TYPER_COMPLETE_ARGS"] = f"elastic-arm simulate --effect {written}"
    done = CliRunner().invoke(app, [], env=environment, prog_name="elastic-arm")
    assert [line.split("\t")[0] for line in done.stdout.split()] == offered
