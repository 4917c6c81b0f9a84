"""The commands of a page of the documentation, run as they stand there."""

import re
import shlex
import subprocess
from contextlib import chdir
from pathlib import Path

from tests.helpers.command_line import run


def run_page(page: str, folder: Path) -> str:
    """Run the commands of a page's shell blocks in a folder; return what they print. None of them
    may fail.

    Those of `elastic-arm` run in this process: to start one for each takes as long as their work.
    """
    commands = "".join(re.findall(r"```sh\n(.*?)```", page, flags=re.DOTALL))
    printed = ""
    with chdir(folder):
        for line in commands.replace("\\\n", " ").splitlines():
            name, *arguments = shlex.split(line, comments=True) or [""]
            if name == "elastic-arm":
                result = run(*arguments)
                assert result.exit_code == 0, result.output
                printed += result.stdout
            elif name:
                printed += subprocess.check_output(["bash", "-c", line], text=True)
    return printed
