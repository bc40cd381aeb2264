"""Scenes that benchmarks share."""
