"""A process of its own that reads one MATLAB file: ``python -P matlab_process.py FILE BYTES SECONDS``.

SciPy's reader of .mat files is compiled code that may end its process on a damaged file, and believes the sizes that a
file claims. Here that costs no more than this process, whose memory (bytes beside what Python itself takes) and
processor time are limited. It runs as a script and imports nothing of the package, so that it starts quickly; the
arrays go to standard output as an .npz file, what is wrong with the file ends as an exception.
"""

from __future__ import annotations

import io
import resource
import sys
from collections.abc import Iterator

import numpy as np
import scipy.io

RAISED, TOO_NEW = 1, 4
"""Exit codes: an exception ended it, as Python has it, and a file of MATLAB 7.3."""

NAMES = "names"


def arrays_of(path: str) -> dict[str, np.ndarray]:
    """Read all arrays of a file; fields of a struct are called `struct.field`."""
    content = scipy.io.loadmat(path)
    return {name: values for top in content for name, values in _flat(top, content[top])}


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


def _limit(kind: int, limit: int) -> None:
    """Limit this process, at most to what it may have already: a limit of the user's shell cannot be raised."""
    _, most = resource.getrlimit(kind)
    limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
    resource.setrlimit(kind, (limit, limit))


def main() -> int:
    """Read the file, write an .npz file to standard output; return the exit code."""
    path, memory, seconds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    with open("/proc/self/statm", encoding="ascii") as status:
        own = int(status.read().split()[0]) * resource.getpagesize()
    for kind, limit in (
        (resource.RLIMIT_AS, own + memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_CORE, 0),
    ):
        _limit(kind, limit)
    try:
        found = arrays_of(path)
    except NotImplementedError:
        return TOO_NEW
    packed = io.BytesIO()
    named = {f"array_{k}": values for k, values in enumerate(found.values())}
    np.savez(packed, **{NAMES: np.array(list(found), dtype=np.str_)}, **named)  # type: ignore[arg-type]
    sys.stdout.buffer.write(packed.getbuffer())
    return 0


if __name__ == "__main__":
    sys.exit(main())
