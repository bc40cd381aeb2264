"""Reconstruction methods of other authors, rebuilt for comparison: one folder per family."""
