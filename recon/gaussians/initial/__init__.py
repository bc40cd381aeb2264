"""The start of a fit: voxel volumes, placement of Gaussians, and their fit to the volumes."""
