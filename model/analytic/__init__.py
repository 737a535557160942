"""Closed forms and series that results are held against. NumPy and SciPy only."""
