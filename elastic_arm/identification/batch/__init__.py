"""Identification from whole recordings: their motion, what they decide, and the identified arm."""
