"""Numerical operators: arrays in, arrays out."""
