"""Voxel volumes as a model of a scan, what a voxel method is, and volumes that fits start from."""
