"""Recordings made ready: dead channels and clocks, and which part is fitted and which judges."""
