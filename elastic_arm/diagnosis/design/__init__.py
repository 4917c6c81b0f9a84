"""The next experiment: motion that discriminates between explanations, and what it is expected to decide."""
