"""The gap between a recording and a model: where it lies, which effect causes it, how far it shrinks, what next."""
