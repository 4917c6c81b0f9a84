"""The blind check: arms whose effect is withheld, made by an engine that shares no code with the
diagnosis."""
