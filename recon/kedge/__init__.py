"""Choice of the basis that the counts warrant, and search for the energies of K edges."""
