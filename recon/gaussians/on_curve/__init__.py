"""Gaussians whose coefficients stay on a curve of materials, which one channel determines."""
