"""Elastic-joint dynamics: bodies, one recursion, three models, compiled kernels."""

from elastic_arm.dynamics.models import Model, build_model

__all__ = ["Model", "build_model"]
