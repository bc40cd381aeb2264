"""Volumes that other programs wrote: reading them, and where they lie in space."""
