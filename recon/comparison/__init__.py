"""Comparison of methods on one dataset: the same views, the same projector, equal time, and the same scores.

`recon.comparison.campaign` runs what is missing, each method in a process of its own (`worker`), which stops it by the
clock (`clock`, `recorder`) and scores it afterwards (`scores`, `protocols`). `table` and `figure` show the results.
"""
