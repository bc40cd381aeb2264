"""One HTML file that needs no network: axial, coronal and sagittal slices of a run, at any energy, beside the truth."""
