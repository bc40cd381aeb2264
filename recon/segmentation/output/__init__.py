"""What a segmentation leaves: volumes, pictures, the table."""
