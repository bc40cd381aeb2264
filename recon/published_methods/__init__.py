"""Methods of others, one folder each."""
