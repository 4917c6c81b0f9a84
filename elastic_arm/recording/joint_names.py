"""Names of joints with and without a prefix that all of them share, such as that of the arm."""

from __future__ import annotations

import re
from collections.abc import Sequence


def short_names(names: Sequence[str]) -> list[str]:
    """Return names without the longest common beginning, up to a mark such as `_`, that leaves each one a letter."""
    ends = [match.end() for match in re.finditer(r"[_./-]", min(names, key=len, default=""))]
    cut = [end for end in ends if len({name[:end] for name in names}) == 1]
    whole = [end for end in cut if all(re.search("[a-zA-Z]", name[end:]) for name in names)]
    return [name[whole[-1] if whole else 0 :] for name in names]


def matched_names(wanted: Sequence[str], recorded: Sequence[str]) -> list[str] | None:
    """Return what the joints wanted are called among those recorded; None where one of them is not there.

    Names that are the same but for a prefix that all of each list share (`fer_`, `panda_`) are those of one joint.
    """
    if set(wanted) <= set(recorded):
        return list(wanted)
    called = dict(zip(short_names(recorded), recorded, strict=True))
    short = short_names(wanted)
    return [called[name] for name in short] if set(short) <= set(called) else None
