"""Files in which scans of others come: images, HDF5, and texts of keys and values."""
