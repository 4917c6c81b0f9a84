"""The only room that draws: figures (matplotlib) and self-contained HTML reports (Jinja)."""
