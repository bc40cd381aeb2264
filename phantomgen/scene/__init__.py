"""From a scene file to a scan: one file per section of the scene file."""
