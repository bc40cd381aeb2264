"""Errors of the stated geometry of a scan, estimated from its projections alone."""
