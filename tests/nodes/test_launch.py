"""The launch files, read by ROS's own launch; wheels of ROS have none, so this runs where ROS is
installed."""

import importlib.util
from pathlib import Path

import pytest

pytest.importorskip("launch_ros", reason="ROS 2 from wheels has no launch")

FILES = sorted((Path(__file__).parents[2] / "launch").glob("*.launch.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_launch_file_describes_nodes_and_arguments(file: Path) -> None:
    """Every launch file makes a description, and every argument has words."""
    spec = importlib.util.spec_from_file_location("launch_file", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    description = module.generate_launch_description()
    arguments = description.get_launch_arguments()
    assert all(argument.description for argument in arguments)
    assert len(description.entities) > len(arguments)
