"""The `elastic-arm` command.

A module without imports of weight: libraries take a second to load, and a Ctrl-C in that time should end the process as
quietly as one later on.
"""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import TYPE_CHECKING

from elastic_arm.blas import one_blas_thread
from elastic_arm.lazy_names import lazily

if TYPE_CHECKING:
    from elastic_arm.cli.application import SUBCOMMANDS, app, load

__all__ = ["SUBCOMMANDS", "app", "load", "main"]

__getattr__ = lazily(__name__, dict.fromkeys(("SUBCOMMANDS", "app", "load"), "elastic_arm.cli.application"))
# Libraries swallow what is raised while they call Python, as CasADi does: a Ctrl-C is raised again after so long, s.
AGAIN = 3.0


def main() -> None:
    """Entry point."""
    one_blas_thread(os.environ)
    heeded = signal.getsignal(signal.SIGINT) is not signal.SIG_IGN  # as behind nohup
    if heeded:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from elastic_arm.cli.application import app
    from elastic_arm.cli.console import guard_output

    guard_output()
    if heeded:
        signal.signal(signal.SIGINT, _interrupt)
        signal.signal(signal.SIGALRM, _interrupt)
    try:
        app()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if heeded:
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.setitimer(signal.ITIMER_REAL, AGAIN)
    raise KeyboardInterrupt
