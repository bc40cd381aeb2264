"""Which basis the counts warrant, and the energies of K edges."""
