"""Motions that excite an arm's parameters: Fourier series within limits, searched for their conditioning."""

from elastic_arm.excitation.fourier import FourierTrajectory, load_trajectory

__all__ = ["FourierTrajectory", "load_trajectory"]
