"""The commands of a page of the documentation, run as they stand there."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run_page(page: str, folder: Path) -> str:
    """Run the commands of a page's shell blocks in a folder; return what they print. None of them
    may fail."""
    commands = "".join(re.findall(r"```sh\n(.*?)```", page, flags=re.DOTALL))
    script = (
        f"set -eu\nelastic-arm() {{ {sys.executable} -c 'from elastic_arm.app import main; main()'"
        ' "$@"; }\n'
    )
    env = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    done = subprocess.run(
        ["bash", "-c", script + commands], cwd=folder, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
