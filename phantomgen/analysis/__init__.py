"""What can be said of a scan or material without simulating: beam quality, thresholds, single-ray Cramer-Rao bound."""
