"""Subcommands with MuJoCo: export, replay, and the corrected files that other commands write."""
