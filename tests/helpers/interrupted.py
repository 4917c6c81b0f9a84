"""Scripts that a Ctrl-C ends, with all processes that they started."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import partial


def interrupted(script: Sequence[str], delay: float, patience: float) -> tuple[int, str]:
    """Return the status of a script, given as arguments of Python, and what it complained of.

    It is interrupted as from a terminal, some seconds after its first line, and given `patience`
    seconds to end.
    """
    process = subprocess.Popen(
        [sys.executable, *script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.default_int_handler),
    )
    process.stdout.readline()
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    _, complaints = process.communicate(timeout=patience)
    return process.returncode, complaints.decode()
