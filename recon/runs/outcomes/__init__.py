"""Finished reconstructions as a run writes, scores and draws them, and the log of their iterations."""
