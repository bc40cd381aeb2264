"""Time and error of fits, and what each part of a fit is worth."""
