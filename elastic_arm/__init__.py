"""Elastic-joint robot arms: emulate, record, identify, and find where and why model and robot differ."""

__version__ = "0.1.0"
