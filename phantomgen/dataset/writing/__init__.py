"""Writing a dataset so that it is complete or absent: writer, NXtomo aliases, journal of finished frames."""
