"""Geometry of scans: positions of source, panel and volume, orbits, and the YAML and table files that state them."""
