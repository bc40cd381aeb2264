"""Closed triangle surfaces: files, checks, tubes along curves; trimesh is imported in mesh.py only."""
