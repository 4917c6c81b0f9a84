"""The blind challenge: arms with withheld effects, simulated by an engine that shares no code with
the diagnosis.
"""
