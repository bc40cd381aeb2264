"""How good a result is: metrics, scores of a fit, noise bound of a voxel model."""
