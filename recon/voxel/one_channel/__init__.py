"""Methods for scans with one channel: filtered back-projection with a water correction, and less metal artefacts."""
