"""Spectral calibration: tube voltage, filter, thresholds and resolution from counts behind known absorbers."""
