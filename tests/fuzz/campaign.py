"""Feed mutants to the readers, and count what is no answer: tracebacks, and hangs."""

import math
import signal
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

import numpy as np

from elastic_arm.errors import ElasticArmError
from tests.fuzz.mutation import mutant
from tests.fuzz.targets import Target, targets

SECONDS = 5.0  # of the processor that a mutant may take
_WAITING = 20.0  # seconds for which it may wait
_TIMERS = (
    (signal.SIGPROF, signal.ITIMER_PROF, SECONDS),
    (signal.SIGALRM, signal.ITIMER_REAL, _WAITING),
)
_LONGEST = 2500  # characters of an error


class Hang(BaseException):
    """A mutant took too long; no Exception, so that nobody catches it by mistake."""


@dataclass
class Outcome:
    """What became of mutants: how many by outcome, and the first tracebacks."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)


def try_one(target: Target, path: Path, content: bytes) -> tuple[str, str]:
    """Return what became of a mutant, put at a path: "read", "refused", "traceback" or "hang", and
    what was raised."""
    path.write_bytes(content)
    for number, timer, seconds in _TIMERS:
        signal.signal(number, _hang)
        signal.setitimer(timer, seconds)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.work(path)
    except ElasticArmError as error:
        words = str(error)
        ok = len(words) < _LONGEST and words.isprintable()
        return (
            ("refused", "")
            if ok
            else ("traceback", f"an error of {len(words)} characters: {words[:200]!r}")
        )
    except Hang:
        return "hang", traceback.format_exc()
    except Exception:  # noqa: BLE001  anything else is what is looked for
        return "traceback", traceback.format_exc()
    finally:
        for _, timer, _ in _TIMERS:
            signal.setitimer(timer, 0.0)
    return "read", ""


def run(
    folder: Path,
    seconds: float,
    rng: np.random.Generator,
    group: str = "",
    mutants: float = math.inf,
) -> dict[str, Outcome]:
    """Feed mutants to the targets of a group (all by default) in turn, for some seconds, or so
    many; return outcomes.

    The folder gets seeds and mutants, and keeps those that failed.
    """
    chosen = {
        name: each for name, each in targets(folder / "seeds").items() if group in ("", each.group)
    }
    found = {name: Outcome() for name in chosen}
    (folder / "failed").mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + seconds
    while (
        time.monotonic() < end
        and sum(outcome.counts.total() for outcome in found.values()) < mutants
    ):
        for name, target in chosen.items():
            content = mutant(target.seeds, rng)
            kind, words = try_one(target, folder / f"mutant{target.suffix}", content)
            found[name].counts[kind] += 1
            if kind in ("traceback", "hang"):
                found[name].failures.append(words)
                number = len(found[name].failures)
                (folder / "failed" / f"{name}_{kind}_{number}{target.suffix}").write_bytes(content)
    return found


def _hang(_: int, __: FrameType | None) -> None:
    raise Hang
