"""What an arm follows: streamed references and goals, checked, interpolated and brought onto the
grid of its steps."""
