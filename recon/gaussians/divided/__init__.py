"""Gaussians divided by a plane: their model, placement along surfaces, and fit to voxel volumes."""
