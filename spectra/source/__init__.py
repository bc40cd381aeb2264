"""X-ray sources: spectra of tubes and lines, filters, the heel effect, beam quality."""
