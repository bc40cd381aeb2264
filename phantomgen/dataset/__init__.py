"""The HDF5 dataset: reading, one file per part of the format, checking, describing."""
