"""Results of a comparison as Markdown, CSV and figures, beside published numbers."""
