"""Cases at the limits of geometry, energies and counts, each against a closed form or an independent value."""
