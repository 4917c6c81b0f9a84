"""Feed mutants to the readers, and count what is no answer: tracebacks, hangs, memory beyond the limit."""

from __future__ import annotations

import math
import multiprocessing
import resource
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
_TIMERS = ((signal.SIGPROF, signal.ITIMER_PROF, SECONDS), (signal.SIGALRM, signal.ITIMER_REAL, _WAITING))
MEMORY = 6_000_000_000  # bytes of addresses that a process may have
_LONGEST = 2500  # characters of an error
_DEAD = 30.0  # seconds without a mutant, after which a process counts as hung in a library


class Hang(BaseException):
    """A mutant took too long; no Exception, so that nobody catches it by mistake."""


@dataclass
class Outcome:
    """What became of mutants: how many by outcome, and the first tracebacks."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)

    @property
    def bad(self) -> int:
        """Mutants that had no proper answer."""
        return sum(self.counts[kind] for kind in ("traceback", "hang", "death"))


def try_one(target: Target, path: Path, content: bytes) -> tuple[str, str]:
    """Return "read", "refused", "traceback" or "hang", and what was raised.

    Parameters
    ----------
    target
        What reads.
    path
        Where the mutant is put.
    content
        The mutant.
    """
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
        return ("refused", "") if ok else ("traceback", f"an error of {len(words)} characters: {words[:200]!r}")
    except Hang:
        return "hang", traceback.format_exc()
    except Exception:  # noqa: BLE001  anything else is what is looked for
        return "traceback", traceback.format_exc()
    finally:
        for _, timer, _ in _TIMERS:
            signal.setitimer(timer, 0.0)
    return "read", ""


def run(
    folder: Path, seconds: float, rng: np.random.Generator, group: str = "", mutants: float = math.inf
) -> dict[str, Outcome]:
    """Feed mutants to the targets in turn for some seconds, in this process; return the outcomes by target.

    Parameters
    ----------
    folder
        For the seeds, the mutants and those that failed.
    seconds
        How long.
    rng
        Draws the mutants.
    group
        "bags", "files", or all.
    mutants
        How many at most.
    """
    chosen = {name: each for name, each in targets(folder / "seeds").items() if group in ("", each.group)}
    found = {name: Outcome() for name in chosen}
    (folder / "failed").mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + seconds
    while time.monotonic() < end and _number(found) < mutants:
        for name, target in chosen.items():
            content = mutant(target.seeds, rng)
            kind, words = try_one(target, folder / f"mutant{target.suffix}", content)
            found[name].counts[kind] += 1
            if kind in ("traceback", "hang"):
                found[name].failures.append(words)
                number = len(found[name].failures)
                (folder / "failed" / f"{name}_{kind}_{number}{target.suffix}").write_bytes(content)
    return found


def run_apart(
    folder: Path, seconds: float, seed: int, group: str = "", mutants: float = math.inf
) -> dict[str, Outcome]:
    """Do what :func:`run` does in a process with limited memory, which is started again where it dies or hangs.

    Parameters
    ----------
    folder, seconds, group, mutants
        As for :func:`run`.
    seed
        Of the mutants.
    """
    total: dict[str, Outcome] = {}
    end, deaths = time.monotonic() + seconds, 0
    context = multiprocessing.get_context("spawn")
    while (left := end - time.monotonic()) > 1.0 and (rest := mutants - _number(total)) > 0:
        begin, receiver_sender = time.monotonic(), context.Pipe(duplex=False)
        process = context.Process(
            target=_limited, args=(folder, min(left, 60.0), seed, group, rest, receiver_sender[1])
        )
        process.start()
        receiver_sender[1].close()
        part: dict[str, Outcome] = {}
        # Received before the process is joined: it cannot end before all that it sends is taken.
        try:
            if receiver_sender[0].poll(min(left, 60.0) + _DEAD):
                part = receiver_sender[0].recv()
        except EOFError:
            pass  # it died
        process.join(1.0)
        if process.exitcode is None:
            process.kill()
            process.join()
        if not part:
            deaths += 1
            words = f"process ended with {process.exitcode} after {time.monotonic() - begin:.0f} s, seed {seed}"
            part = {f"process ({group})": Outcome(Counter(death=1), [words])}
            for file in folder.glob("mutant.*"):
                file.rename(folder / "failed" / f"death_{deaths}_{file.name}")
        for name, outcome in part.items():
            known = total.setdefault(name, Outcome())
            known.counts += outcome.counts
            known.failures += outcome.failures
        seed += 1
    return total


def _number(found: dict[str, Outcome]) -> int:
    return sum(outcome.counts.total() for outcome in found.values())


def _limited(folder: Path, seconds: float, seed: int, group: str, mutants: float, sender: object) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    sender.send(run(folder, seconds, np.random.default_rng(seed), group, mutants))  # type: ignore[attr-defined]


def _hang(_: int, __: FrameType | None) -> None:
    raise Hang
