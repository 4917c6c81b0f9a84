"""The report of the paper's study."""
