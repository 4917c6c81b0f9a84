"""Subcommands of MuJoCo: export and replay, and the corrected files that other commands write."""
