"""Reuse of freed memory for later arrays, and the available memory."""

import ctypes
import math
import os
import sys
from pathlib import Path

# of malloc.h
_TRIM_THRESHOLD = -1
_TOP_PAD = -2
_MMAP_MAX = -4
_ARENA_MAX = -8
_KEPT = 1 << 30  # bytes at the end of the heap that stay
_AHEAD = 1 << 26  # bytes that the heap grows by at once


def keep_memory() -> bool:
    """Let the C library keep freed memory for the next array; return whether it does.

    A diagnosis makes and drops arrays of tens of megabytes, thousands of times, and the system
    clears each page of new ones: a tenth of the processor's time. Threads have no heaps of their
    own, in which as much would be kept again. For commands that end; glibc alone has such settings.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return False
    options = ((_MMAP_MAX, 0), (_TRIM_THRESHOLD, _KEPT), (_TOP_PAD, _AHEAD), (_ARENA_MAX, 1))
    done = [bool(set_option(option, value)) for option, value in options]
    return all(done)


def available_memory() -> float:
    """Return how many bytes may still be taken; infinite where not known.

    The system and this process's limit bound them.

    What the C library keeps for this process (:func:`keep_memory`) is there, too.
    """
    if not sys.platform.startswith("linux"):
        return math.inf
    import resource  # POSIX alone has it

    fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
    found = (
        1024.0 * int(fields["MemAvailable"].split()[0]) if "MemAvailable" in fields else math.inf
    )
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY:
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        found = min(found, limit - taken)
    return found + _kept_bytes()


def _kept_bytes() -> int:
    """Return how many bytes the C library holds that no array uses."""
    try:
        information = ctypes.CDLL(None).mallinfo2
    except (AttributeError, OSError):
        return 0
    information.restype = _Information
    return int(information().fordblks)


_FIELDS = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"


class _Information(ctypes.Structure):
    """struct mallinfo2 of malloc.h."""

    _fields_ = tuple((name, ctypes.c_size_t) for name in _FIELDS.split())
