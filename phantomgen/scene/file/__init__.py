"""Reading the YAML text: models with line numbers for complaints, overrides, presets, random values and places."""
