"""Phases of a scan whose object moves or changes: Gaussians with shared shapes, and what differs from phase to phase."""
