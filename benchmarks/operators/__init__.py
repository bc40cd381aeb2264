"""Time and error of single operators."""
