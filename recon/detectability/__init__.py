"""Task-based image quality of a run: how well an insert is detected, by observers of its images and of its counts."""
