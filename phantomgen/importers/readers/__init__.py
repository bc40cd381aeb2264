"""Formats of scans, one module each, with ``read(paths, stated)``, which returns a `RawScan`."""
