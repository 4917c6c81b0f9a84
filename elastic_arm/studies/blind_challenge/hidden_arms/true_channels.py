"""What a hidden arm did, before its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TrueChannels:
    """What really happened, at the samples.

    Parameters
    ----------
    t
        (N,) s.
    q, dq, theta, dtheta
        (N, n) at the instant of the sample.
    tau_J, tau_m
        (N, n) means over the sample interval centred on it.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    tau_J: np.ndarray
    tau_m: np.ndarray
