"""The command phantomgen, one file per command: parse, call, print."""
