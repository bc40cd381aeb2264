"""Static figures of a run, and colours of bases."""
