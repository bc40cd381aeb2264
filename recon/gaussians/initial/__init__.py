"""First Gaussians from volumes: placement and fit to the volumes."""
