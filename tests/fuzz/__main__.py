"""`make fuzz`: fuzz for minutes or hours, print a table, and keep the mutants that failed.

    python -m tests.fuzz --minutes 60 --seed 1 --out runs/fuzz
    python -m tests.fuzz --mutants 10000        # so many of bags and of files each

What kills the process, or hangs it within a library, ends the run; the mutant is the last one in
the folder.
"""

import argparse
import faulthandler
import math
import resource
import sys
from collections import Counter
from pathlib import Path

import numpy as np

from tests.fuzz.campaign import Outcome, run

KINDS = ("read", "refused", "traceback", "hang")
MEMORY = 6_000_000_000  # bytes of addresses that the process may have


def main() -> int:
    """Run a campaign; return 1 if a mutant had no proper answer."""
    parser = argparse.ArgumentParser(
        prog="tests.fuzz", description="Feed mutants to all readers of files."
    )
    parser.add_argument("--minutes", type=float, default=60.0, help="how long (60)")
    parser.add_argument(
        "--mutants",
        type=float,
        default=math.inf,
        help="end after so many of bags and of files each",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the mutants (0)")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/fuzz"), help="folder of the mutants that failed"
    )
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    faulthandler.enable()
    groups = ("bags", "files")
    rng = np.random.default_rng(options.seed)
    found: dict[str, Outcome] = {}
    for group in groups:
        seconds = 60.0 * options.minutes / len(groups)
        faulthandler.dump_traceback_later(seconds + 60.0, exit=True)
        found |= run(options.out / group, seconds, rng, group, options.mutants)
    faulthandler.cancel_dump_traceback_later()
    rows = [(name, outcome.counts) for name, outcome in found.items()]
    rows.append(("all", sum((counts for _, counts in rows), Counter())))
    print(f"{'target':16}{'mutants':>9}" + "".join(f"{kind:>11}" for kind in KINDS))
    for name, counts in rows:
        print(f"{name:16}{counts.total():9}" + "".join(f"{counts[kind]:11}" for kind in KINDS))
    failures = [f"{name}: {words}" for name, outcome in found.items() for words in outcome.failures]
    (options.out / "failures.txt").write_text("\n\n".join(failures))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
