"""Motions that excite the parameters of an arm: Fourier series within limits, optimised for
conditioning.
"""

from elastic_arm.excitation.criteria import CRITERIA, BaseRegressor, find_criterion
from elastic_arm.excitation.fourier import FourierTrajectory, load_trajectory
from elastic_arm.excitation.limits import MARGIN, LimitUse, MotionLimits
from elastic_arm.excitation.problem import Shape, liveliest, random_trajectories
from elastic_arm.excitation.search import ExcitationResult, optimise
from elastic_arm.excitation.workspace import Workspace

__all__ = [
    "CRITERIA",
    "MARGIN",
    "BaseRegressor",
    "ExcitationResult",
    "FourierTrajectory",
    "LimitUse",
    "MotionLimits",
    "Shape",
    "Workspace",
    "find_criterion",
    "liveliest",
    "load_trajectory",
    "optimise",
    "random_trajectories",
]
