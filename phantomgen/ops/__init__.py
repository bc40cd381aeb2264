"""Numerical operators: arrays in, arrays out."""

from pathlib import Path

from spectra.kernel_cache import ensure_kernel_cache

ensure_kernel_cache(Path(__file__).parent)
