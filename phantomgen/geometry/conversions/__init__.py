"""Geometry of scans in the terms of other programs, and back: pure functions, one file per program."""
