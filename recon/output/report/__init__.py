"""One page with the figures and scores of finished runs of one scan."""
