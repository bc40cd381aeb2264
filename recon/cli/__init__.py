"""The command recon, one file per command: parse, call, print."""
