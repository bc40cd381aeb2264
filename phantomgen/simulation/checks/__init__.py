"""Questions put to a scan: how wrong are the counts, do objects collide, what is in the field of view."""
