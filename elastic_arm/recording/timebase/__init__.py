"""One time base: what stamps mean, and both sides of the joints at the same times."""
