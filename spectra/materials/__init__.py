"""Materials with a density: compositions, mixtures, electron density."""
