"""A fixed set of scans with known truth, which results can be stated on: definition, files, and their hashes."""
