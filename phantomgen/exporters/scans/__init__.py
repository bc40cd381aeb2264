"""Folders that other programs read: projections and geometry of a scan, one file per program."""
