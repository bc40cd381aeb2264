"""Material maps against the truth."""
