"""From a dataset to what a fit sees.

Measurements, their defects and noise, line integrals, edges, where arrays live.
"""
