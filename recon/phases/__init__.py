"""Phases of a scan whose object moves or changes: Gaussians of shared shapes, and what differs between phases."""
