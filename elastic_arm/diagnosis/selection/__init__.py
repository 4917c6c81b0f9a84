"""Which effects belong: candidates, their regressors, stepwise search, refinement of nonlinear parameters."""
