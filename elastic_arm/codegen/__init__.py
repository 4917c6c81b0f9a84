"""Compiled code from CasADi functions: straight-line programs, printed as C or run by NumPy, and
cached on disk.

The package can be used on its own; see docs/codegen.md.
"""
