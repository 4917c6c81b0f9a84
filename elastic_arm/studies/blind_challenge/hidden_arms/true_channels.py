"""What a hidden arm did, before its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TrueChannels:
    """What really happened, at the samples."""

    t: np.ndarray  # (N,) s
    # q, dq, theta, dtheta: (N, n) at the instant of the sample
    q: np.ndarray
    dq: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    # tau_J, tau_m: (N, n) means over the sample interval centred on it
    tau_J: np.ndarray
    tau_m: np.ndarray
