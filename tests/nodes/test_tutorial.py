"""The first session of docs/ros.md, run as it stands there."""

import os
import re
import subprocess
from pathlib import Path

import pytest
from domain_coordinator import domain_id

from elastic_arm.identification import Identification

pytestmark = [pytest.mark.graph, pytest.mark.nightly, pytest.mark.slow(20)]

ROOT = Path(__file__).parents[2]


def test_the_commands_of_the_page_do_what_it_describes(tmp_path: Path) -> None:
    """Every block ends without an error, and both estimates find the friction of joint 2."""
    page = (ROOT / "docs" / "ros.md").read_text()
    session = page.split("## A first session")[1].split("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", session, flags=re.DOTALL)
    assert len(blocks) == 4
    # Runs go where the test wants them; a shell script that stops at the first error, with bash's
    # own words.
    script = "\n".join(["set -eu", *blocks])
    with domain_id() as domain:
        env = {
            **os.environ,
            "RUNS": str(tmp_path),
            "ROS_DOMAIN_ID": str(domain),
            "PYTHONPATH": str(ROOT),
        }
        env |= {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        done = subprocess.run(
            ["bash", "-c", script],
            cwd=ROOT,
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=300,
        )
    said = done.stdout.decode()
    assert done.returncode == 0, said
    assert "Traceback" not in said
    for folder in ("identified", "online"):
        found = Identification.load(tmp_path / folder / "identification.json")
        (torque,) = [
            e.value for e in found.estimates if "coulomb_friction" in e.name and "joint_2" in e.name
        ]
        assert torque == pytest.approx(13.9, abs=1.0), folder
    assert "<robot" in (tmp_path / "arm.urdf").read_text()
