"""What Gaussians leave unexplained, in voxels."""
