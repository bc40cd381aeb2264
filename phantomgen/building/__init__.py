"""Scenes that are built in Python, with the keys of scene files."""
