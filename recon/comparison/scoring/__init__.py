"""All scores of one model of a comparison, by named protocols."""
