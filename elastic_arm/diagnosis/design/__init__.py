"""The next experiment: motion that discriminates between competing effects, and what it is expected to decide."""
