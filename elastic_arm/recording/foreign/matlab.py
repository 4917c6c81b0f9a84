"""MATLAB files, read in a process of their own with limits of memory and time."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.foreign import matlab_process

# Processor time: to start, and for each byte of the file (packed files of 10 MB take a second).
START_SECONDS = 20
BYTES_A_SECOND = 1_000_000
# Time on the clock: a busy machine gives a process a tenth of a core.
PATIENCE = 10


def load_matlab(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a .mat file; fields of a struct are called `struct.field`."""
    seconds = START_SECONDS + path.stat().st_size // BYTES_A_SECOND
    command = [sys.executable, "-P", matlab_process.__file__, str(path), str(limits.unpacked_bytes()), str(seconds)]
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    try:
        run = subprocess.run(command, capture_output=True, timeout=PATIENCE * seconds, env=os.environ | one_thread)
    except subprocess.TimeoutExpired:
        raise RecordingError(f"{path} takes more than {PATIENCE * seconds} s to read", "Save it as .npz.") from None
    if run.returncode == matlab_process.TOO_NEW:
        raise RecordingError(f"{path} is a MATLAB 7.3 file", "Save it with -v7.")
    if run.returncode != 0:
        raise RecordingError(f"{path} cannot be read: {_reason(run)}", "Check the path and the format.")
    with np.load(io.BytesIO(run.stdout), allow_pickle=False) as content:
        names = content[matlab_process.NAMES].tolist()
        return {name: content[f"array_{k}"] for k, name in enumerate(names)}


def _reason(run: subprocess.CompletedProcess[bytes]) -> str:
    """Return in words why the process did not read the file."""
    if run.returncode == matlab_process.RAISED:
        return " ".join(run.stderr.decode("utf-8", "replace").strip().splitlines()[-1:])[:200] or "it is damaged"
    if run.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return "it takes too long"
    if run.returncode < 0:
        return f"it is damaged so that SciPy's reader ends with {signal.Signals(-run.returncode).name}"
    return f"SciPy's reader ended with exit code {run.returncode}"
