"""Figures (matplotlib) and self-contained HTML reports (Jinja); only the studies draw as well."""
