"""Results in formats of other programs, one file per format; volumes have theirs in `phantomgen.exporters`."""
