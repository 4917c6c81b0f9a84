"""The entry point of the `elastic-arm` command.

This module has no heavy imports: the libraries take a second to load, and Ctrl-C during that time
should end the process as quietly as later. SIGTERM acts like Ctrl-C, so that child processes and
temporary files of a command do not outlive it.
"""

import atexit
import os
import signal
import sys
from contextlib import suppress
from types import FrameType
from typing import TYPE_CHECKING

from elastic_arm.lazy_names import lazily

if TYPE_CHECKING:
    from elastic_arm.cli.application import SUBCOMMANDS, app, load

__all__ = ["SUBCOMMANDS", "app", "load", "main"]

__getattr__, __dir__ = lazily(
    __name__, dict.fromkeys(("SUBCOMMANDS", "app", "load"), "elastic_arm.cli.application")
)
# Libraries swallow what is raised while they call Python, as CasADi does: interrupts are raised
# again after so long, s.
AGAIN = 3.0
LIBRARIES = 4e8  # bytes of addresses, measured; some of them wait for ever where there are none


def main() -> None:
    """Entry point."""
    # Some are ignored, as behind nohup.
    heeded = [
        number
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) is not signal.SIG_IGN
    ]
    for number in heeded:
        signal.signal(number, signal.SIG_DFL)
    from elastic_arm.blas import one_blas_thread
    from elastic_arm.errors import ElasticArmError
    from elastic_arm.memory import available_memory

    if (there := available_memory()) < LIBRARIES:
        sys.stderr.write(
            f"error: {there / 1e6:.0f} MB of memory are free, and the libraries alone need"
            f" {LIBRARIES / 1e6:.0f} MB. Raise the memory limit (ulimit -v), or free memory.\n"
        )
        raise SystemExit(2)
    one_blas_thread(os.environ)
    from elastic_arm.cli.application import app
    from elastic_arm.cli.console import guard_output

    guard_output()
    interrupts = _Interrupts()
    try:
        for number in (*heeded, *([signal.SIGALRM] if heeded else [])):
            signal.signal(number, interrupts.take)
        app()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number in heeded:
            signal.signal(number, signal.SIG_DFL)
        if interrupts.came is not None:
            # Whatever a library made of it: one that is being imported may turn it into an
            # ImportError. Taking all libraries down, and waiting for threads, would take ten times
            # as long as all else.
            atexit._run_exitfuncs()
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ElasticArmError):
                    stream.flush()
            os._exit(128 + interrupts.came)


class _Interrupts:
    """The signals that end a command."""

    def __init__(self) -> None:
        self.came: int | None = None

    def take(self, number: int, frame: FrameType | None) -> None:
        """Interrupt whatever runs, and once more after a while."""
        self.came = self.came or number
        signal.setitimer(signal.ITIMER_REAL, AGAIN)
        raise KeyboardInterrupt


if __name__ == "__main__":
    main()
