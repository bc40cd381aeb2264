"""Divided Gaussians on a GPU: their numbers by torch in float64, pixels and voxels by Triton in float32."""
