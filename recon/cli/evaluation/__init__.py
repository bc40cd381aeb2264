"""Commands that score results: one volume, methods on one scan, and methods on the scans of a suite."""
