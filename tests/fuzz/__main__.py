"""`make fuzz`: fuzz for minutes or hours, print a table, and keep the mutants that failed.

python -m tests.fuzz --minutes 60 --seed 1 --out runs/fuzz
python -m tests.fuzz --mutants 10000        # so many of bags and of files each
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from pathlib import Path

from tests.fuzz.campaign import Outcome, run_apart

KINDS = ("read", "refused", "traceback", "hang", "death")


def main() -> int:
    """Run a campaign; return 1 if a mutant had no proper answer."""
    parser = argparse.ArgumentParser(prog="tests.fuzz", description="Feed mutants to all readers of files.")
    parser.add_argument("--minutes", type=float, default=60.0, help="how long (60)")
    parser.add_argument("--mutants", type=float, default=math.inf, help="end after so many of bags and of files each")
    parser.add_argument("--seed", type=int, default=0, help="of the mutants (0)")
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="folder of the mutants that failed")
    options = parser.parse_args()
    groups = ("bags", "files")
    seconds = 60.0 * options.minutes / len(groups)
    found: dict[str, Outcome] = {}
    for group in groups:
        found |= run_apart(options.out / group, seconds, options.seed, group, options.mutants)
    rows = [(name, outcome.counts) for name, outcome in found.items()]
    rows.append(("all", sum((counts for _, counts in rows), Counter())))
    print(f"{'target':16}{'mutants':>9}" + "".join(f"{kind:>11}" for kind in KINDS))
    for name, counts in rows:
        print(f"{name:16}{counts.total():9}" + "".join(f"{counts[kind]:11}" for kind in KINDS))
    last = Counter(
        (name, words.strip().splitlines()[-1][:150]) for name, outcome in found.items() for words in outcome.failures
    )
    for (name, words), count in last.most_common(30):
        print(f"{count:6} {name}: {words}")
    (options.out / "failures.txt").write_text("\n\n".join(w for o in found.values() for w in o.failures[:50]))
    return 1 if any(outcome.bad for outcome in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
