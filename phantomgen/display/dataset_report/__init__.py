"""A page about a dataset: what was scanned, with what, and how exact its counts are."""
