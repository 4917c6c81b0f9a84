"""From a CasADi function to compiled code: a straight-line program, printed as C or run by NumPy,
cached on disk.

Reusable by itself; docs/codegen.md is the page on it.
"""
