"""What makes a dataset trusted: the only door to its arrays, its digests, and the table of its format."""
