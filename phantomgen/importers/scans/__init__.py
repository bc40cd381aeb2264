"""Scans of other programs and of scanners: what all formats give, and how it becomes a dataset."""
