"""One whole run: plan memory and time, reconstruct, score, write a folder, resume."""
