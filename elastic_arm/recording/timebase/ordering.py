"""Sort messages by their stamps, even if they arrived out of order or the clock was set during the
recording."""

import numpy as np

from elastic_arm.arrays import Indices, Mask
from elastic_arm.recording.inspection.report import Finding, check_stamped, moment
from elastic_arm.recording.sides import Stamps

LATE_NS = 1_000_000_000  # no message is on its way for longer
_AROUND = 50  # messages on either side of a step back that show whether the clock stays behind


def in_order(stamp_ns: Stamps, topic: str, log_ns: Stamps) -> tuple[Stamps, Indices, list[Finding]]:
    """Return stamps (N',) in order, the position of each message, and the corrections.

    If the clock was set back, the later stamps continue from the earlier ones, or one second later
    after a longer pause. Messages that overtook each other are sorted. A message whose stamp is far
    from all others is left out.
    """
    check_stamped(stamp_ns, topic)
    stamp_ns, found = _one_clock(stamp_ns.copy(), topic, log_ns)
    rows = np.argsort(stamp_ns, kind="stable")
    overtaken = stamp_ns < np.maximum.accumulate(stamp_ns)
    if not overtaken.any():
        return stamp_ns, rows, found
    far = _far_off(stamp_ns[rows], rows)
    if far.any():
        words = (
            f"{topic}: {far.sum()} of {len(rows)} messages have a stamp more than a second"
            " from all others, the first"
        )
        message = f"{words} {moment(stamp_ns, int(rows[far].min()))}: they are skipped"
        found.append(Finding("warning", "stray_stamps", message, topic=topic))
        rows = rows[~far]
        kept = stamp_ns[np.sort(rows)]
        overtaken = kept < np.maximum.accumulate(kept)
    if overtaken.any():
        kept = stamp_ns[np.sort(rows)]
        late = float((np.maximum.accumulate(kept) - kept).max()) * 1e-9
        words = (
            f"{topic}: {overtaken.sum()} of {len(rows)} messages arrived after later ones,"
            f" by up to {late:.3g} s"
        )
        found.append(
            Finding("note", "out_of_order", f"{words}: they are sorted by stamp", topic=topic)
        )
    return stamp_ns[rows], rows, found


def _one_clock(stamp_ns: Stamps, topic: str, log_ns: Stamps) -> tuple[Stamps, list[Finding]]:
    """Shift stamps forward after the clock was set back: stamps that occur a second time show
    this."""
    found: list[Finding] = []
    ranked = np.sort(stamp_ns)
    steps = np.diff(ranked)
    usual = float(np.median(steps[steps > 0]))
    for k in np.flatnonzero(np.diff(stamp_ns) < 0).tolist():
        since = stamp_ns[max(k + 1 - _AROUND, 0) : k + 1 + _AROUND] - stamp_ns[k]
        number = np.arange(len(since)) - min(k, _AROUND - 1)
        ahead = since - usual * number
        back = float(np.median(ahead[number <= 0]) - np.median(ahead[number > 0]))
        again, until = np.searchsorted(ranked, (stamp_ns[k + 1], stamp_ns[k]))
        # 0.75 sample intervals, below which two clocks seem to stamp in turn
        crowded = np.mean(steps[again:until] < 0.75 * usual) if until > again else 0.0
        # A hole that no message came through, as none is on its way for a second
        apart = until > again and steps[again:until].max() > LATE_NS
        # 0.2 of the intervals that stand twice in what the clock passed twice; half where that is
        # all of it
        if (
            back > 0.5 * (stamp_ns[k] - stamp_ns[k + 1])
            and (crowded > 0.2 or apart)
            and number[-1] > 5
        ):
            words = (
                f"{topic}: the clock was set back by {back * 1e-9:.4g} s after"
                f" {moment(stamp_ns, k)}"
            )
            message = f"{words}: later stamps are shifted by as much"
            if (silent := int(log_ns[k + 1] - log_ns[k])) > LATE_NS:
                # The same of all topics, whenever each arrived: they belong together.
                message = f"{message}, and the gap of {silent * 1e-9:.3g} s is shortened to 1 s"
                back = back + LATE_NS
            time = float(stamp_ns[k] - stamp_ns[0]) * 1e-9
            found.append(Finding("warning", "clock_set_back", message, topic=topic, time=time))
            stamp_ns[k + 1 :] += round(back)
    return stamp_ns, found


def _far_off(stamp_ns: Stamps, rows: Indices) -> Mask:
    """Return which sorted stamps, of messages that arrived as `rows`, are isolated at an end
    although they did not arrive there."""
    far = np.zeros(len(rows), np.bool_)
    for ends, last in ((range(len(rows) - 1, 0, -1), len(rows) - 1), (range(len(rows) - 1), 0)):
        for i in ends:
            inner = i - 1 if last else i + 1
            if rows[i] == last or abs(int(stamp_ns[i] - stamp_ns[inner])) < LATE_NS:
                break
            far[i] = True
    return far
