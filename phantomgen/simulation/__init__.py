"""One run from a scan to its dataset: what it writes in which order, and what it reports."""
