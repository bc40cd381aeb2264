"""Figures of a run, each with its numbers as CSV beside it where it has curves."""
