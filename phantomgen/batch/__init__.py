"""Many scans from one manifest."""
