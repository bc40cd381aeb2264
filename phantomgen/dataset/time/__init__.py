"""Time of the views of a dataset, and what the truth says of it."""
