"""Projections at few energies that a dataset keeps, so that other spectra need no new rays."""
