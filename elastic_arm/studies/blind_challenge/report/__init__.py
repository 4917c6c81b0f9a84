"""The challenge's report."""
