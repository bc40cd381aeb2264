"""Energy grids and numerics on them: bins, interpolation, fewer nodes, interpolative decomposition."""
