"""What files are worth when they are damaged."""
