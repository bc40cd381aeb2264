"""A page about one run, or about several of the same scan side by side: one file per section."""
