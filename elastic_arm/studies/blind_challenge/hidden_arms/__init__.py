"""The arms of the challenge, simulated apart: no law, model or estimate of the suite stands behind
a recording."""
