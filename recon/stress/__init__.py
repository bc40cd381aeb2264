"""Hard cases of reconstruction: Gaussians, rays and scans at their limits."""
