"""Quality of a result: metrics, scores of a fit, verdict for a user, noise bound of a voxel model."""
