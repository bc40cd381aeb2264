"""Material maps: `recon.segment` finds them in a fit or in a run folder. The truth is read only to score them."""
