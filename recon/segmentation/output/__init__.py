"""Files of a segmentation: volumes, pictures, the table."""
