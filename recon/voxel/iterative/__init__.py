"""Iterative reconstructions of voxels, one method per file, and what they share."""
