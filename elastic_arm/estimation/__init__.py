"""The motion of a recording: resampling, noise, smoothing, equations, whitening, regressors.

Identification and diagnosis both use this package.
"""
