"""MATLAB files, read by ``python -P matlab.py FILE BYTES SECONDS``: a process of its own with bounds.

SciPy's reader of .mat files is compiled code that may end its process on a damaged file, and believes the sizes that a
file claims. Here that costs no more than this process, whose memory (bytes beside what Python itself takes) and
processor time are limited. As a script it imports nothing of the package, so that it starts quickly; the arrays go to
standard output as an .npz file, what is wrong with the file ends as an exception.
"""

from __future__ import annotations

import io
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

# Processor time: to start, and for each byte of the file (packed files of 10 MB take a second).
START_SECONDS = 20
BYTES_A_SECOND = 1_000_000
PATIENCE = 10  # time on the clock for a second of the processor: a busy machine gives a process a tenth of a core
TOO_NEW = 4  # exit code for a file of MATLAB 7.3
SCRIPT = __file__


def load_matlab(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays of a .mat file; fields of a struct are called `struct.field`."""
    from elastic_arm.errors import RecordingError
    from elastic_arm.recording import limits

    seconds = START_SECONDS + path.stat().st_size // BYTES_A_SECOND
    command = [sys.executable, "-P", SCRIPT, str(path), str(limits.unpacked_bytes()), str(seconds)]
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    try:
        run = subprocess.run(command, capture_output=True, timeout=PATIENCE * seconds, env=os.environ | one_thread)
    except subprocess.TimeoutExpired:
        raise RecordingError(f"{path} takes more than {PATIENCE * seconds} s to read", "Save it as .npz.") from None
    if run.returncode == TOO_NEW:
        raise RecordingError(f"{path} is a MATLAB 7.3 file", "Save it with -v7.")
    if run.returncode != 0:
        reason = " ".join(run.stderr.decode("utf-8", "replace").strip().splitlines()[-1:])[:200] or "it is damaged"
        if run.returncode < 0:
            reason = (
                f"SciPy's reader ends with {signal.Signals(-run.returncode).name}: it is damaged, or takes too long"
            )
        raise RecordingError(f"{path} cannot be read: {reason}", "Check the path and the format.")
    with np.load(io.BytesIO(run.stdout), allow_pickle=False) as content:
        return {name: content[f"array_{k}"] for k, name in enumerate(content["names"].tolist())}


def _flat(name: object, values: object) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays of a MATLAB variable: those of a struct's fields, or itself."""
    # What MATLAB keeps for itself has no name, or one with two underscores in front.
    if not isinstance(name, str) or name.startswith("__") or not isinstance(values, np.ndarray):
        return
    if values.dtype.names is None:
        # Cells hold what is no number and cannot be sent as plain data.
        yield name, np.full(values.shape, "cell") if values.dtype.hasobject else values
    elif values.size == 1:
        for field in values.dtype.names:
            yield from _flat(f"{name}.{field}", values[field].item())


def _main(path: str, memory: int, seconds: int) -> int:
    """Read the file within the bounds and write an .npz file to standard output."""
    import scipy.io

    own = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    bounds = {resource.RLIMIT_AS: own + memory, resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0}
    for kind, bound in bounds.items():
        _, most = resource.getrlimit(kind)  # a limit of the user's shell cannot be raised
        bound = bound if most == resource.RLIM_INFINITY else min(bound, most)
        resource.setrlimit(kind, (bound, bound))
    try:
        content = scipy.io.loadmat(path)
    except NotImplementedError:
        return TOO_NEW
    found = dict(pair for top in content for pair in _flat(top, content[top]))
    packed = io.BytesIO()
    named = {f"array_{k}": values for k, values in enumerate(found.values())}
    np.savez(packed, names=np.array(list(found), dtype=np.str_), **named)  # type: ignore[arg-type]
    sys.stdout.buffer.write(packed.getbuffer())
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
