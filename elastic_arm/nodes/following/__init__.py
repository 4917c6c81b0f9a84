"""The motion that an arm follows: streamed references and goals are checked, interpolated and
sampled at the steps of the arm."""
