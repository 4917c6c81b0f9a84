"""Effects that act where a description or a user states them, and that no diagnosis looks for: one file an effect."""
