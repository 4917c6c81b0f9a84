"""Recordings that others made: channel maps, arrays."""
