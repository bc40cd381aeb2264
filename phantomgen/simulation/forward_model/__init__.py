"""From a scan to frames and truth.

Expected counts, scatter, noise, detector, readings, energy grids, and the settings of their accuracy.
"""
