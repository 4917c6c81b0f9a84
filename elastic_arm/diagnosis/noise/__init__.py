"""The noise of the residuals, from what hypotheses leave: its colour, and its size at each joint and side."""
