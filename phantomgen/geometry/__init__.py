"""Where source.

Panel and volume are: poses, orbits, panel, voxel grid, and the YAML and table files that state them.
"""
