"""Bags on disk: storage formats behind one reader, metadata, writing."""
