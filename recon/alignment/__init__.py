"""Where the panel was, from the views of a scan themselves."""
