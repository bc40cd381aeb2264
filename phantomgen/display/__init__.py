"""Everything that draws: one folder per kind of picture."""
