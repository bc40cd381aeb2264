"""From a dataset to the measurements of a fit.

Measurements, their defects and noise, line integrals, edges, storage of arrays.
"""
