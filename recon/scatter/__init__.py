"""Scatter in a reconstruction: estimated from volumes or from counts, and subtracted from the counts."""
