"""The study of the paper: an independent virtual prototype, the figures, and the claims."""
