"""Classical reconstructions, one method per file."""
