"""Filtered back-projection."""
