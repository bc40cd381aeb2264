"""Commands that compute without a scan: energies, dose, and hard cases."""
