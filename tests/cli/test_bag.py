"""The bag subcommands: what they print, what they leave behind, and their exit codes."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from elastic_arm.recording import read_recording, write_recording
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.guess import guess_mapping
from tests.helpers.bags import assert_equal, two_sided
from tests.helpers.command_line import run


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "bag", two_sided(np.random.default_rng(0), 2000))


def test_info_shows_topics_rates_joints_and_channels(bag: Path) -> None:
    """A table for people, the same as JSON for scripts."""
    shown = run("bag", "info", bag)
    assert shown.exit_code == 0
    for word in ("/joint_states", "/motor_states", "1000", "joint_3", "motor.effort", "zstd"):
        assert word in shown.stdout
    told = json.loads(run("bag", "info", bag, "--json").stdout)
    assert told["messages"] == 4000
    assert told["duration"] == pytest.approx(1.999)
    assert told["joints"] == ["joint_1", "joint_2", "joint_3"]
    assert [topic["rate"] for topic in told["topics"]] == pytest.approx([1000, 1000])


def test_check_ends_with_0_for_a_sound_bag(bag: Path) -> None:
    """Nothing wrong: exit code 0."""
    done = run("bag", "check", bag)
    assert (done.exit_code, "no faults found" in done.stdout) == (0, True)


def test_check_ends_with_1_for_a_torn_bag_and_repairs_it(bag: Path) -> None:
    """Something wrong: exit code 1; with --repair a usable copy beside it, and 0."""
    (bag / "metadata.yaml").unlink()
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-3000])
    assert run("bag", "check", bag).exit_code == 1
    done = run("bag", "check", bag, "--repair", "--json")
    told = json.loads(done.stdout)
    assert done.exit_code == 0
    assert not told["ok"]
    assert told["repaired"]["after"]["ok"]
    assert Path(told["repaired"]["path"]) == bag.with_name("bag_repaired")
    assert len(read_recording(told["repaired"]["path"]).link) > 0


def test_several_bags_and_folders_are_checked_one_by_one(bag: Path, tmp_path: Path) -> None:
    """Each has an opinion of its own; what is no bag does not stop the others, and is the exit
    status."""
    again = tmp_path / "runs" / "again"
    shutil.copytree(bag, again)
    done = run("bag", "check", bag, again.parent, "--json")
    told = json.loads(done.stdout)["bags"]
    assert done.exit_code == 0 and [one["path"] for one in told] == [str(bag), str(again)]
    done = run("bag", "check", tmp_path / "nothing", bag)
    assert (
        done.exit_code == 2 and "does not exist" in done.stdout and "no faults found" in done.stdout
    )
    assert run("bag", "check", bag, again, "--out", tmp_path / "x").exit_code == 2


def test_check_ends_with_2_for_what_is_no_bag(tmp_path: Path) -> None:
    """Not readable at all: exit code 2 and one line that says why."""
    done = run("bag", "check", tmp_path / "nothing")
    assert done.exit_code == 2
    assert "does not exist" in done.stderr


def test_import_makes_a_bag(tmp_path: Path) -> None:
    """Arrays and a mapping in, a bag out; a second time it is refused and untouched."""
    np.savez(
        tmp_path / "run.npz",
        t=np.arange(100) * 0.01,
        q=np.random.default_rng(0).normal(size=(100, 1)),
    )
    content = {"times": {"key": "t"}, "joints": ["joint_1"], "link": {"position": {"key": "q"}}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(content))
    arguments = (
        "bag",
        "import",
        tmp_path / "run.npz",
        "--map",
        tmp_path / "map.yaml",
        "--out",
        tmp_path / "bag",
    )
    done = run(*arguments)
    assert done.exit_code == 0
    assert "link.position" in done.stdout
    assert len(read_recording(tmp_path / "bag").link) == 100
    again = run(*arguments)
    assert (again.exit_code, "already exists" in again.stderr) == (2, True)


@pytest.mark.parametrize("name", ["excitation", "validation"])
def test_shipped_bags_have_nothing_wrong(name: str) -> None:
    """The bags that come with the project pass the check, their streamed reference included."""
    bag = Path(__file__).parents[2] / "bags" / name
    checked = json.loads(run("bag", "check", bag, "--json").stdout)
    assert checked["findings"] == []
    assert "/reference" in run("bag", "info", bag).stdout


def test_a_dataset_becomes_a_bag_an_episode_and_a_bag_becomes_arrays_and_the_same_bag(
    tmp_path: Path, bag: Path
) -> None:
    """What is done is printed: rows left out, samples of each side, and the command that makes the
    bag again."""
    t = np.arange(100) / 50.0
    rows = [f"{k},{a},{np.sin(a)},{np.cos(a) if a != t[5] else ''}" for k in (0, 1) for a in t]
    (tmp_path / "run.csv").write_text("run,t,q1,q2\n" + "\n".join(rows) + "\n")
    draft = guess_mapping(load_arrays(tmp_path / "run.csv"), ["a", "b"])
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    done = run(
        "bag",
        "import",
        tmp_path / "run.csv",
        "--map",
        tmp_path / "map.yaml",
        "--out",
        tmp_path / "bags",
    )
    assert (
        done.exit_code == 0
        and done.stdout.count("1 of 100 rows have missing values on the link side") == 2
    )
    assert [len(read_recording(tmp_path / "bags" / f"run_{k}").link or ()) for k in (0, 1)] == [
        99,
        99,
    ]
    done = run("bag", "export", bag, "--out", tmp_path / "out" / "a.parquet")
    assert done.exit_code == 0 and "2000 samples of the motor side" in done.stdout
    command = done.stdout.partition("elastic-arm bag ")[2].partition(" imports")[0].split()
    assert run("bag", *command[:-1], tmp_path / "again").exit_code == 0
    assert_equal(read_recording(tmp_path / "again"), read_recording(bag))
    again = run("bag", "export", bag, "--out", tmp_path / "out" / "a.parquet")
    assert again.exit_code == 2 and "overwrite the results with --force" in again.output
    assert (
        run("bag", "export", bag, "--out", tmp_path / "out" / "a.parquet", "--force").exit_code == 0
    )


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("run.csv", "elastic-arm bag import {} --guess"),
        ("episode.parquet", "elastic-arm bag import {} --guess"),
        ("set/data/chunk/episode.parquet", "elastic-arm bag import {} --guess"),
        ("run.bag", "rosbags-convert --src {} --dst run"),
    ],
)
def test_what_is_no_bag_names_the_command_that_makes_one(
    tmp_path: Path, name: str, command: str
) -> None:
    """Tables, datasets and bags of ROS 1."""
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("t,q\n0,1\n")
    given = tmp_path / name.partition("/")[0]
    done = run("bag", "check", given)
    assert done.exit_code == 2 and command.format(given) in " ".join(done.output.split())
