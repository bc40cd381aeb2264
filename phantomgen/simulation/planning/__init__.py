"""The cheapest settings that meet a tolerance, and what the scan will cost."""
