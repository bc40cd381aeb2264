"""Files that a scene file names: spectra, response matrices, voxel volumes."""
