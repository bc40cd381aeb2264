"""Iterative reconstruction of voxels: one method per file, the loop of the linear ones, likelihood and grids."""
