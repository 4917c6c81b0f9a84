"""From a recording to its motion: resampling, noise, smoothing, equations, whitening, regressors.

Identification and diagnosis both build on this package; neither has a second way of doing what is
here.
"""
