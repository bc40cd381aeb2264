"""Detectors: what each channel measures of a photon of each energy, and counts lost to dead time."""
