"""Residuals and columns of a recording from numbers, laws and sensors."""
