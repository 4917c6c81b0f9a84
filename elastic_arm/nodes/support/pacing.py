"""Steps on a clock: when the next one is due, and how well the pace was held."""

from __future__ import annotations


class Pace:
    """A schedule of steps `1 / rate` of simulated time apart, run at `factor` times real time.

    A late step is caught up on: the schedule is of absolute times, so delays do not add up. Only after falling behind
    by more than `patience` seconds is the schedule moved, which :attr:`slipped` counts.
    """

    def __init__(self, rate: float, factor: float = 1.0, patience: float = 0.5) -> None:
        self.rate, self.patience = rate, patience
        self.slipped = 0.0
        self._interval = 1.0 / (rate * factor)
        self._due: float | None = None
        self._window: tuple[float, int] | None = None
        self._steps = 0

    def set_factor(self, factor: float) -> None:
        """Go on at another speed."""
        self._interval = 1.0 / (self.rate * factor)

    def wait(self, now: float) -> float:
        """Return the seconds until the next step is due; zero or less when it is."""
        if self._due is None:
            self._due, self._window = now, (now, 0)
        return self._due - now

    def stepped(self, now: float) -> None:
        """Note that a step was made."""
        assert self._due is not None, "wait() comes before stepped()"
        self._steps += 1
        self._due += self._interval
        if now - self._due > self.patience:
            self.slipped += now - self._due
            self._due = now

    def hold(self, now: float) -> None:
        """Stand still until `now`: what was due before is due from here on, without a slip."""
        if self._due is not None:
            self._due = max(self._due, now)

    def achieved(self, now: float) -> float:
        """Return the steps per real second since the last call, relative to the rate set; 1 before the first step."""
        if self._window is None or now <= self._window[0]:
            return 1.0
        began, steps = self._window
        self._window = (now, self._steps)
        return (self._steps - steps) * self._interval / (now - began)
