"""Figures (matplotlib) and self-contained HTML reports (Jinja): the only package that draws, but
for the studies."""
