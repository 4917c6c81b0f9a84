"""Studies with the suite: the paper, and the blind challenge. Nothing imports this package."""
