"""Standard deviations of a result, from the spread between reconstructions of scans with other noise."""
