"""Folders that methods of neural networks and Gaussians read: circles, with views for tests."""
