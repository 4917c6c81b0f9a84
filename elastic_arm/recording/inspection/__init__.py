"""Check a recording: contents of a bag, its faults, and their repair."""
