"""Static figures (PNG, PDF, SVG) and the style that all figures of the project share."""
