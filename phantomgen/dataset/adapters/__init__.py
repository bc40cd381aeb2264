"""A dataset as objects of other libraries."""
