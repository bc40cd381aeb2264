"""Comparison of methods on one dataset: the same views, the same projector, equal time, and the same scores.

`recon.comparison.campaign` computes missing results, each method in a separate process (`worker`). The process stops
the method by the clock (`clock`, `recorder`) and scores it afterwards (`scores`, `protocols`). Results are
shown by `table` and `figure`.
"""
