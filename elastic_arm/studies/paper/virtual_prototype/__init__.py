"""The virtual prototype of the paper in MuJoCo, an independent engine."""
