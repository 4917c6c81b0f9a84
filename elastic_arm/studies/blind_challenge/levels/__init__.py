"""The levels of the challenge beyond the laboratory: arms that are a little wrong everywhere, with ordinary sensors."""
