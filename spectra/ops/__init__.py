"""Numerical operators on arrays, one folder each."""
