"""Commands whose results have no room, or no permission, on a real file system: a line each,
whatever they write."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.command_line import refusal, run
from tests.helpers.motions import trajectory
from tests.helpers.nightly import nightly
from tests.helpers.small_disk import fill, make_read_only, mounted

COMMANDS = {
    "simulate": ("simulate", "--trajectory", "{motion}", "--rate", "100", "--out", "{disk}/bag"),
    "identify": ("identify", "{bag}", "--out", "{disk}/identified"),
    "diagnose": ("diagnose", "{bag}", "--out", "{disk}/diagnosis", "--quiet"),
    "history": ("history", "{bag}", "{killed}", "--workers", "1", "--out", "{disk}/history"),
    "describe": ("describe", "--urdf", "{disk}/arm.urdf"),
    "bag check": ("bag", "check", "{killed}", "--repair", "--out", "{disk}/mended"),
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A motion, a bag of it, and what a killed recorder would have left of that."""
    folder = tmp_path_factory.mktemp("inputs")
    motion = folder / "motion.yaml"
    trajectory(n=3, period=9.0, ramp=0.5, periods=1).scaled(0.05).save(motion)
    command = [
        "simulate",
        "--trajectory",
        str(motion),
        "--rate",
        "100",
        "--out",
        str(folder / "bag"),
    ]
    assert run(*command).exit_code == 0
    shutil.copytree(folder / "bag", folder / "killed")
    (folder / "killed" / "metadata.yaml").unlink()
    content = (folder / "bag" / "bag_0.mcap").read_bytes()
    (folder / "killed" / "bag_0.mcap").write_bytes(content[: 9 * len(content) // 10])
    return {"motion": str(motion), "bag": str(folder / "bag"), "killed": str(folder / "killed")}


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    with mounted(tmp_path / "disk", 200) as folder:
        yield folder


@pytest.mark.parametrize(
    ("state", "reasons"),
    [
        ("full", ["No space left on device"]),
        ("read-only", ["is not writable", "Read-only file system"]),
    ],
)
@pytest.mark.parametrize(
    "command", ["simulate", "describe", "bag check", *nightly(["identify", "diagnose", "history"])]
)
def test_a_disk_that_takes_nothing_ends_a_command_with_one_line(
    command: str, state: str, reasons: list[str], inputs: dict[str, str], disk: Path
) -> None:
    """The line names the place and the system's reason."""
    fill(disk) if state == "full" else make_read_only(disk)
    line = refusal(*(part.format(**inputs, disk=disk) for part in COMMANDS[command]))
    assert str(disk) in line and any(reason in line for reason in reasons)
