"""The catalogue: one file an effect. A file of this folder that holds an `EFFECT` is in the
catalogue."""
